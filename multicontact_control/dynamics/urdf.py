"""A URDF as XML: read in any encoding, and checked to be one tree of links."""

from __future__ import annotations

from collections import defaultdict
import re
import xml.etree.ElementTree as ElementTree

from multicontact_control.errors import ConfigError

DECLARATION = re.compile(rb'^\s*<\?xml[^>]*encoding=["\']([\w.:-]+)["\']')
# Microsoft's and the later national standard: the files that are called by the first hold those.
SUPERSETS = {'shift_jis': 'cp932', 'gb2312': 'gb18030', 'gbk': 'gb18030'}


def parse_urdf(text: str | bytes) -> ElementTree.Element:
    """
    Return the root element of a URDF, whose tags have no default namespace.

    Parameters
    ----------
    text
        Content of the file. Bytes may be in any encoding that Python knows and their XML names.

    Raises
    ------
    ConfigError
        If it is no XML, or has quaternions where URDF readers ignore them.

    """
    try:
        root = _parse_xml(text)
    except ElementTree.ParseError as error:
        raise ConfigError('urdf', 'a valid URDF', str(error)) from None
    namespace = re.match(r'{[^}]*}', root.tag)
    if namespace:
        for element in root.iter():
            element.tag = element.tag.removeprefix(namespace[0])
    _refuse_ignored_quaternions(root)
    return root


def _parse_xml(text: str | bytes) -> ElementTree.Element:
    """Return the root element of XML in any encoding that Python knows; ConfigError."""
    try:
        return ElementTree.fromstring(text)
    except (ValueError, LookupError):  # expat knows encodings of one byte, and Unicode
        content = text
    if isinstance(content, str):
        content = content.encode()
    declaration = DECLARATION.match(content)
    if declaration is None:
        raise ConfigError('urdf', 'a valid URDF', 'text in an unknown encoding')
    name = declaration[1].decode()
    encoding = SUPERSETS.get(name.lower(), name)
    try:
        decoded = content.decode(encoding)
    except LookupError:
        raise ConfigError(
            'urdf', 'an encoding that is known, e.g. UTF-8', name
        ) from None
    except UnicodeDecodeError as error:
        raise ConfigError(
            'urdf',
            f'text in {name}, as its first line says',
            f'something else at byte {error.start}',
        ) from None
    return ElementTree.fromstring(decoded)


def _refuse_ignored_quaternions(root: ElementTree.Element) -> None:
    """Refuse quaternions, which count from version 1.1 on and are ignored before."""
    version = root.get('version', '1.0')
    if version != '1.0':
        return
    for element in (*root.findall('link'), *root.findall('joint')):
        if element.find('.//origin[@quat_xyzw]') is not None:
            raise ConfigError(
                f'urdf.{element.get("name")}.origin',
                'rpy, in version 1.0',
                'quat_xyzw',
                hint='version="1.1" in the element `robot` makes it count',
            )


def find_joint_ends(joint: ElementTree.Element) -> tuple[str, str]:
    """Return the names of the parent and child link of a joint; empty where it does not say."""
    return _find_end(joint, 'parent'), _find_end(joint, 'child')


def _find_end(joint: ElementTree.Element, end: str) -> str:
    element = joint.find(end)
    if element is None:
        return ''
    return element.get('link', '')


def check_link_tree(root: ElementTree.Element) -> None:
    """
    Check that the joints of a URDF make one tree of its links.

    Raises
    ------
    ConfigError
        If a joint names a link that there is not, if two joints carry the same link, or if none
        or several links are carried by no joint.

    """
    links = [link.get('name', '') for link in root.findall('link')]
    carriers = defaultdict[str, list[str]](list)  # joints by the link that they carry
    for joint in root.findall('joint'):
        name = joint.get('name', '')
        for end in ('parent', 'child'):
            link = _find_end(joint, end)
            if link not in links:
                raise ConfigError(
                    f'urdf.{name}.{end}', 'a link of the URDF', f"'{link}'"
                )
        carriers[link].append(name)
    for link, joints in carriers.items():
        if len(joints) > 1:
            raise ConfigError(
                'urdf',
                'one parent of each link',
                f'{link}, which is the child of {" and ".join(joints)}',
            )
    bases = [link for link in links if link not in carriers]
    if len(bases) != 1:
        found = ', '.join(bases) if bases else 'none'
        raise ConfigError('urdf', 'one link that no joint carries, the base', found)
