"""Set-up of the whole test session."""

from pathlib import Path

import open3d as o3d
import pytest
from hypothesis import settings

# Nothing here is about time, so there is no deadline. The usual run draws the same cases each time; `make test-all`
# looks for new ones.
settings.register_profile("repeatable", deadline=None, derandomize=True)
settings.register_profile("search", deadline=None, max_examples=500)
settings.load_profile("repeatable")


@pytest.hookimpl(trylast=True)
def pytest_sessionfinish() -> None:
    # A test that reads the context of a system inside a diagram leaks that context (see `export_outputs`), and Open3D
    # would list its tensors after the test report.
    o3d.utility.set_verbosity_level(o3d.utility.VerbosityLevel.Error)


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of recorded data beside the checkout."""
    folder = Path(__file__).parents[2] / "shared" / "data"
    if not folder.is_dir():
        pytest.skip(f"the recorded data are not there: {folder}")
    return folder


@pytest.fixture
def balm(shared_data):
    """177 scans of a hand-held LiDAR with the poses of a LiDAR-inertial odometry as truth."""
    return shared_data / "balm_hku"
