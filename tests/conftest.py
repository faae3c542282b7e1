"""Set-up of the whole test session."""

import open3d as o3d
import pytest


@pytest.hookimpl(trylast=True)
def pytest_sessionfinish() -> None:
    # A test that reads the context of a system inside a diagram leaks that context (see `export_outputs`), and Open3D
    # would list its tensors after the test report.
    o3d.utility.set_verbosity_level(o3d.utility.VerbosityLevel.Error)
