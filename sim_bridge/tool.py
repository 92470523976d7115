"""A tool that we put on an arm, as a configuration says it."""

from __future__ import annotations

from multicontact_control.config import Config, parameter, Real, Vector3
from sim_bridge.arm import Body, Placement


class ToolData(Config):
    """The tool beyond the wrist sensor, in the sensor's frame."""

    face_offset: Real = parameter(..., 'Operational point to sensor face, along its z.', unit='m')
    face_mass: Real = parameter(..., 'Mass of the face itself.', unit='kg', gt=0.0)
    mass: Real = parameter(..., 'Mass of the tool.', unit='kg', gt=0.0)
    com: Vector3 = parameter(..., 'Centre of mass of the tool.', unit='m')
    inertia: Vector3 = parameter(..., 'Ixx, Iyy, Izz about the com.', unit='kg m^2')
    tips: dict[str, Vector3] = parameter(..., 'Bar tips by URDF link name.', unit='m')

    @property
    def body(self) -> Body:
        """Return its mass properties, in the sensor's frame."""
        return Body(self.mass, Placement(self.com), self.inertia)
