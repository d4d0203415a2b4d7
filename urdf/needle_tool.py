"""A needle behind a force/torque sensor: the tool of the paper, and its relatives."""

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from urdf.errors import InputError
from urdf.finite_array import finite_array, read_only
from urdf.payload import Payload


@dataclass(frozen=True, slots=True, kw_only=True)
class NeedleTool:
    """F/T sensor, hub and needle in a row along the flange's z axis, pointing outward.

    The tool of the paper's authors weighs 236 g up to the sensor's measuring plane and 68 g beyond
    it, and its needle reaches 153 mm from there. Its inertias follow from shapes:

    - Sensor: a Mini45 fills 45 mm by 15.7 mm with 92 g; at that density 236 g of sensor and
      adapters of the same diameter are 40 mm high. A homogeneous cylinder.
    - Shaft: a solid steel cylinder (7850 kg/m^3) of 1.27 mm (18 gauge) from the hub to the tip
      weighs 1.2 g. A 68 g needle of 153 mm would be 8.5 mm thick, so nearly all of the 68 g is what
      holds it:
    - Hub: the rest of ``needle_mass_kg``, a homogeneous cylinder at the measuring plane. 67 g of
      aluminium 30 mm across are 35 mm high.

    Attributes:
        sensor_mass_kg: Mass on the flange's side of the measuring plane, kg.
        sensor_height_m: From the flange face to the measuring plane, m.
        sensor_diameter_m: Diameter of the sensor, m.
        needle_mass_kg: Mass beyond the measuring plane, hub and shaft, kg.
        needle_length_m: From the measuring plane to the tip, m.
        needle_diameter_m: Outer diameter of the shaft, m.
        shaft_density_kg_m3: Density of the shaft; lower it for a hollow needle, kg/m^3.
        hub_length_m: Height of the hub, less than ``needle_length_m``, m.
        hub_diameter_m: Diameter of the hub, m.

    Raises:
        InputError: A number that is not finite, not positive (masses may be zero), or a shaft
            heavier or a hub longer than the needle.
    """

    sensor_mass_kg: float = 0.236
    sensor_height_m: float = 0.040
    sensor_diameter_m: float = 0.045
    needle_mass_kg: float = 0.068
    needle_length_m: float = 0.153
    needle_diameter_m: float = 0.00127
    shaft_density_kg_m3: float = 7850.0
    hub_length_m: float = 0.035
    hub_diameter_m: float = 0.030

    def __post_init__(self) -> None:
        for item in fields(self):
            value = float(finite_array(getattr(self, item.name), (), f"NeedleTool {item.name}"))
            may_be_zero = item.name in ("sensor_mass_kg", "needle_mass_kg", "shaft_density_kg_m3")
            if value < 0.0 or (value == 0.0 and not may_be_zero):
                raise InputError(f"NeedleTool {item.name} is {value:g}, expected a positive number")
        if self.hub_length_m >= self.needle_length_m:
            raise InputError(
                f"NeedleTool hub_length_m {self.hub_length_m:g} must be shorter than "
                f"needle_length_m {self.needle_length_m:g}, measured from the sensor to the tip"
            )
        if self.shaft_mass_kg > self.needle_mass_kg:
            raise InputError(
                f"NeedleTool shaft of {self.needle_diameter_m:g} m across weighs "
                f"{self.shaft_mass_kg:.4g} kg, more than needle_mass_kg {self.needle_mass_kg:g}; "
                "give a thinner shaft or a lower shaft_density_kg_m3"
            )

    @property
    def shaft_mass_kg(self) -> float:
        """Mass of the bare shaft between hub and tip, kg."""
        length = self.needle_length_m - self.hub_length_m
        return self.shaft_density_kg_m3 * np.pi / 4.0 * self.needle_diameter_m**2 * length

    @property
    def sensor(self) -> Payload:
        """The part on the flange's side of the measuring plane, in the flange frame."""
        return _cylinder(self.sensor_mass_kg, 0.0, self.sensor_height_m, self.sensor_diameter_m)

    @property
    def beyond_sensor(self) -> Payload:
        """Hub and shaft, whose weight and inertia the sensor reads, in the sensor frame."""
        hub_mass = self.needle_mass_kg - self.shaft_mass_kg
        hub = _cylinder(hub_mass, 0.0, self.hub_length_m, self.hub_diameter_m)
        shaft = _cylinder(
            self.shaft_mass_kg, self.hub_length_m, self.needle_length_m, self.needle_diameter_m
        )
        return hub + shaft

    @property
    def payload(self) -> Payload:
        """The whole tool in the flange frame."""
        return self.sensor + self.beyond_sensor.moved(np.eye(3), [0.0, 0.0, self.sensor_height_m])

    @property
    def tip_in_flange_m(self) -> NDArray[np.float64]:
        """Needle tip in the flange frame, shape (3,), m."""
        return read_only([0.0, 0.0, self.sensor_height_m + self.needle_length_m])


def _cylinder(mass_kg: float, start_m: float, end_m: float, diameter_m: float) -> Payload:
    """Return a homogeneous cylinder on the z axis between two heights."""
    length, radius = end_m - start_m, 0.5 * diameter_m
    across = mass_kg * (3.0 * radius**2 + length**2) / 12.0
    return Payload(
        mass_kg=mass_kg,
        com_m=np.array([0.0, 0.0, start_m + 0.5 * length]),
        inertia_kg_m2=np.diag([across, across, 0.5 * mass_kg * radius**2]),
    )
