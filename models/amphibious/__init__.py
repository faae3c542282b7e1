"""The amphibious robot: `amphibious.urdf`, and the script that writes it."""
