"""The illuminance robot of S4: `lux_robot.urdf`, the script that writes it, and its behaviours."""
