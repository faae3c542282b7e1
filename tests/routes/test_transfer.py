"""A route learnt on the map of a short drive holds in the world that the map is of."""

from tests.benchmarks.transfer_drive import try_yard


def test_a_route_learnt_on_a_map_by_slam_is_driven_without_touching_anything():
    yard = try_yard(0, ("slam",))
    assert yard["status"] == "driven"
    assert yard["gap"] <= 0.05
    assert yard["way_m"] > 3
    assert yard["slam_arrived"]
    assert yard["slam_error"] < 0.2
    assert yard["slam_touched"] == 0
    assert yard["slam_pose_error"] < 0.1
