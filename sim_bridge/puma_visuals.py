"""What the PUMA 560 with its tool looks like, in its proportions."""

from __future__ import annotations

import math

from multicontact_control.config import Vector3
from sim_bridge.visuals import BOX, CYLINDER, DARK, GREY, SPHERE, STEEL, Visual

ALONG_Y: Vector3 = (math.pi / 2.0, 0.0, 0.0)  # of a cylinder's axis, z otherwise

# Frames are those of `puma560.puma_arm`. The upper arm runs 0.24 m beside the trunk and the
# forearm 0.15 m, as on the machine; link 3's y and link 4's z point along the forearm.
VISUALS: dict[str, tuple[Visual, ...]] = {
    'base_link': (
        Visual(BOX, (0.30, 0.30, 0.02), (0.0, 0.0, 0.01), colour=DARK),
        Visual(CYLINDER, (0.085, 0.48), (0.0, 0.0, 0.26))),
    'link1': (
        Visual(CYLINDER, (0.075, 0.09), (0.0, 0.0, 0.545), colour=GREY),
        Visual(CYLINDER, (0.095, 0.32), (0.0, -0.042, 0.67183), ALONG_Y)),
    'link2': (
        Visual(CYLINDER, (0.10, 0.085), (0.0, 0.0, 0.2435)),
        Visual(BOX, (0.4318, 0.17, 0.08), (0.2159, 0.0, 0.2435)),
        Visual(BOX, (0.12, 0.13, 0.07), (-0.12, 0.0, 0.2435), colour=GREY),
        Visual(CYLINDER, (0.085, 0.08), (0.4318, 0.0, 0.2435))),
    'link3': (
        Visual(CYLINDER, (0.065, 0.10), (0.0, 0.0, 0.153), colour=GREY),
        Visual(BOX, (0.10, 0.36, 0.09), (0.0203, 0.11, 0.15005)),
        Visual(BOX, (0.075, 0.06, 0.075), (0.0203, 0.31, 0.15005))),
    'link4': (
        Visual(CYLINDER, (0.036, 0.06), (0.0, 0.0, 0.368), colour=DARK),
        Visual(CYLINDER, (0.040, 0.04), (0.0, 0.0, 0.412), colour=GREY)),
    'link5': (
        Visual(CYLINDER, (0.034, 0.085), (0.0, 0.0, 0.0), colour=DARK),
        Visual(SPHERE, (0.038,), (0.0, 0.0, 0.0), colour=GREY)),
    'link6': (
        Visual(CYLINDER, (0.026, 0.010), (0.0, 0.0, 0.035), colour=GREY),
        Visual(CYLINDER, (0.038, 0.016), (0.0, 0.0, 0.048), colour=DARK)),
    'tool': (
        Visual(CYLINDER, (0.034, 0.008), (0.0, 0.0, 0.004), colour=STEEL),
        Visual(CYLINDER, (0.009, 0.168), (0.0, 0.0, 0.092), colour=STEEL),
        Visual(SPHERE, (0.009,), (0.0, 0.0, 0.175), colour=DARK),
        Visual(SPHERE, (0.012,), (0.0, 0.0, 0.134), colour=STEEL),
        Visual(CYLINDER, (0.008, 0.144), (0.0, 0.080, 0.134), ALONG_Y, STEEL),
        Visual(SPHERE, (0.009,), (0.0, 0.151, 0.134), colour=DARK)),
}
