"""Where on the ground a camera stands, and the air above it: what sensor files, telemetry, the sky and simulation share.

Latitude and longitude are asked; the other numbers have the usual values of `SITE_FIELDS` where nobody gives them, and the pressure
that of the height (`sky.ground`). A calibration says which of them it assumed.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class SiteField:
    """One number of a site: its unit, its bounds, what it is, and its value where it may be left out."""

    name: str
    unit: str
    lowest: float
    highest: float
    sentence: str
    usual: float | None = None
    optional: bool = True

    @property
    def label(self) -> str:
        """What a form calls it, with its unit."""
        words = self.name.rpartition("_")[0] if self.unit else self.name
        return words.replace("_", " ").capitalize() + (f", {self.unit}" if self.unit else "")


#: Every number of a site, by name. Elevations below some degrees are beyond the model, and so are other wavelengths.
SITE_FIELDS = {
    one.name: one
    for one in (
        SiteField("latitude_deg", "°", -90.0, 90.0, "geodetic latitude, north positive", optional=False),
        SiteField("longitude_deg", "°", -180.0, 360.0, "longitude, east positive", optional=False),
        SiteField("height_m", "m", -500.0, 9000.0, "height above the ellipsoid", 0.0),
        SiteField("pressure_hpa", "hPa", 0.0, 1100.0, "air pressure at the site itself, not reduced to sea level"),
        SiteField("temperature_c", "°C", -70.0, 60.0, "air temperature", 10.0),
        SiteField("relative_humidity", "", 0.0, 1.0, "relative humidity, 0 to 1", 0.5),
        SiteField("wavelength_um", "µm", 0.3, 2.5, "wavelength at which the detector is most sensitive", 0.6),
    )
}


@dataclass(frozen=True)
class Site:
    """Where on the ground a camera stands, and the air above it; None where nobody gave it.

    Latitude and longitude in degrees, geodetic, east positive; height in metres; pressure in hectopascals at the site; temperature
    in degrees Celsius; humidity from 0 to 1; wavelength in micrometres.
    """

    latitude_deg: float
    longitude_deg: float
    height_m: float | None = None
    pressure_hpa: float | None = None
    temperature_c: float | None = None
    relative_humidity: float | None = None
    wavelength_um: float | None = None

    def document(self) -> dict[str, float]:
        """Return what is given of it as a sensor file has it."""
        return {name: value for name, value in vars(self).items() if value is not None}

    @property
    def assumed(self) -> list[str]:
        """Names of the numbers that nobody gave."""
        return [name for name in SITE_FIELDS if getattr(self, name) is None]

    def get(self, name: str) -> float:
        """Return a number of it as given, else the usual one."""
        value = getattr(self, name)
        return float(SITE_FIELDS[name].usual or 0.0) if value is None else float(value)
