"""Physical constants, each with its source."""

GM_EARTH_KM3_S2 = 398600.4418
"""Geocentric gravitational constant, WGS 84 / EGM96 [km3/s2]."""

EARTH_RADIUS_KM = 6378.137
"""Equatorial radius of WGS 84 [km]; `altitude_km` of an orbit is semi-major axis minus this."""

EARTH_FLATTENING = 1.0 / 298.257223563
"""Flattening of WGS 84."""

J2_EARTH = 1.08262668e-3
"""Second zonal harmonic, unnormalised, EGM96 (C20 = -484.165372e-6, times -sqrt 5)."""

EARTH_RATE_RAD_S = 7.292115e-5
"""Rotation rate of the Earth, WGS 84 [rad/s]."""

AU_KM = 149597870.7
"""Astronomical unit, IAU 2012 Resolution B2 [km]."""

SUN_RADIUS_KM = 695700.0
"""Nominal solar radius, IAU 2015 Resolution B3 [km]."""

SOLAR_CONSTANT_W_M2 = 1361.0
"""Nominal total solar irradiance at 1 au, IAU 2015 Resolution B3 [W/m2]."""

FIELD_RADIUS_KM = 6371.2
"""Reference radius of the IGRF, Alken et al. 2021 (doi 10.1186/s40623-020-01288-x) [km]."""

NT_PER_MG = 100.0
"""1 mG = 1e-3 G = 1e-7 T = 100 nT. mG stands only in the papers' tables and figures."""

AM2_PER_POLE_CM = 1.0e-3
"""1 pole cm (emu) = 1e-3 A m2: the 1e5 pole-cm torquer of Seasat is 100 A m2."""

MU0_OVER_4PI_NT_M3_PER_AM2 = 100.0
"""mu0/(4 pi) = 1e-7 T m/A, in nT m3/(A m2)."""

SPEED_OF_LIGHT_M_S = 299792458.0
"""Speed of light, exact by the definition of the metre [m/s]."""
