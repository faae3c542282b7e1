"""Diagrams: the station (robot, world, sensors), one file per mission, and the command line."""
