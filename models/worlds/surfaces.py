"""Surfaces that the shipped worlds are made of. Optical values are rough ones for 903 nm and 1450 nm."""

from naraha.systems.sensing import Surface

CONCRETE_FLOOR = Surface(label="floor", lidar_reflectivity=0.35, nir_reflectance=0.35)
CONCRETE_WALL = Surface(label="wall", lidar_reflectivity=0.5, nir_reflectance=0.45)
STEEL = Surface(label="metal", lidar_reflectivity=0.45, nir_reflectance=0.5, specular=0.3, attenuation=57.0)
STAIR = Surface(label="stair", lidar_reflectivity=0.5, nir_reflectance=0.5, specular=0.1, attenuation=57.0)
WOOD = Surface(label="crate", lidar_reflectivity=0.5, nir_reflectance=0.5, attenuation=5.0)
RUBBLE = Surface(label="debris", lidar_reflectivity=0.3, nir_reflectance=0.3)
WATER = Surface(label="water", lidar_reflectivity=0.02, nir_reflectance=0.02, specular=0.98, attenuation=8.6)
HOT_PIPE = Surface(
    label="heat", lidar_reflectivity=0.45, nir_reflectance=0.5, specular=0.3, temperature=80.0, attenuation=57.0
)
SOURCE = Surface(label="source", lidar_reflectivity=0.6, nir_reflectance=0.5, activity=50.0, attenuation=0.0)
SIGN = Surface(label="sign", lidar_reflectivity=1.0, nir_reflectance=0.9)
# What a near-infrared camera takes for water.
BLACK_PANEL = Surface(label="panel", lidar_reflectivity=0.05, nir_reflectance=0.04, attenuation=10.0)
RUBBER = Surface(label="rubber", lidar_reflectivity=0.05, nir_reflectance=0.05, attenuation=8.6)
WET_WALL = Surface(label="wet_wall", lidar_reflectivity=0.15, nir_reflectance=0.04, specular=0.2)
