"""The Pioneer 3-DX: `pioneer.urdf`, and the script that writes it."""
