"""
tf2_msgs/TFMessage without tf2_msgs: its schema, and its bytes.

The wheels have no tf2_msgs, so the type can be recorded but not published. It is a list of
geometry_msgs/TransformStamped, which is simple enough to be laid out here.
"""

from __future__ import annotations

from collections.abc import Sequence
import struct

from multicontact_control.dynamics.link_transforms import LinkTransform

TF_TYPE = 'tf2_msgs/msg/TFMessage'
TF_TEXT = 'geometry_msgs/TransformStamped[] transforms\n'
TF_HASH = 'RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087'

CDR_LITTLE_ENDIAN = b'\x00\x01\x00\x00'
NANOSECONDS = 1_000_000_000


def tf_bytes(stamp: int, transforms: Sequence[LinkTransform]) -> bytes:
    """
    Return a TFMessage as CDR, with its encapsulation header.

    Parameters
    ----------
    stamp
        Time of all transforms [ns].
    transforms
        The poses.

    """
    # Alignment counts from the end of the encapsulation header.
    body = bytearray(struct.pack('<I', len(transforms)))
    for transform in transforms:
        _align(body, 4)
        body += struct.pack('<iI', *divmod(stamp, NANOSECONDS))
        _add_string(body, transform.parent)
        _add_string(body, transform.child)
        _align(body, 8)
        body += struct.pack('<7d', *transform.translation, *transform.quaternion_xyzw)
    return CDR_LITTLE_ENDIAN + bytes(body)


def _align(body: bytearray, size: int) -> None:
    body += bytes(-len(body) % size)


def _add_string(body: bytearray, text: str) -> None:
    _align(body, 4)
    data = text.encode() + b'\0'
    body += struct.pack('<I', len(data)) + data
