"""Simulated sensors on SceneGraph geometry, and readers of recorded scans."""

from .scan import PointCloud, Scan

__all__ = ["PointCloud", "Scan"]
