"""2D localisation and mapping with a laser scanner."""

from .laser_scan import LaserRing, LaserScan, LaserScanError, no_scan, ring_to_laser_scan

__all__ = ["LaserRing", "LaserScan", "LaserScanError", "no_scan", "ring_to_laser_scan"]
