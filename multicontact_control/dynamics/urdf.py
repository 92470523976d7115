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

    ConfigError if it is no XML, or says something that URDF readers take for something else.
    """
    try:
        root = _parse(text)
    except ElementTree.ParseError as error:
        raise ConfigError('urdf', 'a valid URDF', str(error)) from None
    namespace = re.match(r'{[^}]*}', root.tag)
    if namespace:
        for element in root.iter():
            element.tag = element.tag.removeprefix(namespace[0])
    _refuse_ignored_turns(root)
    return root


def _parse(text: str | bytes) -> ElementTree.Element:
    """Return the root element of XML in any encoding that Python knows; ConfigError."""
    try:
        return ElementTree.fromstring(text)
    except (ValueError, LookupError):  # expat knows encodings of one byte, and Unicode
        content = text.encode() if isinstance(text, str) else text
    declared = DECLARATION.match(content)
    if declared is None:
        raise ConfigError('urdf', 'a valid URDF', 'text in an unknown encoding')
    name = declared[1].decode()
    try:
        decoded = content.decode(SUPERSETS.get(name.lower(), name))
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


def _refuse_ignored_turns(root: ElementTree.Element) -> None:
    """Refuse rotations that count from version 1.1 on, and are ignored before."""
    version = root.get('version', '1.0')
    if version != '1.0':
        return
    for element in (*root.findall('link'), *root.findall('joint')):
        if any('quat_xyzw' in origin.attrib for origin in element.iter('origin')):
            raise ConfigError(
                f'urdf.{element.get("name")}.origin',
                'rpy, in version 1.0',
                'quat_xyzw',
                hint='version="1.1" in the element `robot` makes it count',
            )


def find_joint_ends(joint: ElementTree.Element) -> tuple[str, str]:
    """Return parent and child link of a joint; empty where it does not say."""
    links = []
    for end in ('parent', 'child'):
        element = joint.find(end)
        links.append('' if element is None else element.get('link', ''))
    parent, child = links
    return parent, child


def check_link_tree(root: ElementTree.Element) -> None:
    """Check that the joints of a URDF make one tree of its links; ConfigError."""
    links = [link.get('name', '') for link in root.findall('link')]
    carriers = defaultdict[str, list[str]](list)  # of a link, the joints
    for joint in root.findall('joint'):
        name = joint.get('name', '')
        parent, child = find_joint_ends(joint)
        for end, link in (('parent', parent), ('child', child)):
            if link not in links:
                raise ConfigError(
                    f'urdf.{name}.{end}', 'a link of the URDF', f"'{link}'"
                )
        carriers[child].append(name)
    for link, joints in carriers.items():
        if len(joints) > 1:
            raise ConfigError(
                'urdf',
                'one parent of each link',
                f'{link}, which is the child of {" and ".join(joints)}',
            )
    bases = [link for link in links if link not in carriers]
    if len(bases) != 1:
        raise ConfigError(
            'urdf',
            'one link that no joint carries, the base',
            ', '.join(bases) or 'none',
        )
