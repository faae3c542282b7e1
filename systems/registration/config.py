"""How clouds are registered, and when the result is believed."""

from dataclasses import dataclass, field

from ..config import quantity
from .attribute_icp import AttributeIcpConfig

METHODS = ("surfaces", "attributes", "point_to_point", "point_to_plane", "generalized")
KERNELS = ("none", "tukey", "geman_mcclure")


@dataclass(kw_only=True)
class SurfacesConfig:
    """Our registration: small planes (surfels) of both clouds are laid on each other."""

    # [m] Surfels are planes through what is this near. Less is noisier, more loses what is small.
    radius: float = quantity(0.5, unit="m", above=0)
    # [-] Far away it is this part of the distance from the sensor (clouds with rings), so that it spans two rings.
    widening: float = quantity(0.05, unit="-", low=0)
    # [m] Largest thickness (standard deviation) of a surfel; more is no plane.
    thickness: float = quantity(0.04, unit="m", above=0)
    # [m] Surfels are no nearer to each other than about this.
    spacing: float = quantity(0.25, unit="m", above=0)
    # [m] Clouds without rings are first thinned to means of voxels of this size.
    grain: float = quantity(0.1, unit="m", above=0)
    # [m] Loss (Tukey) on the distance to a plane: width at first, and at last. The first bounds the error of the guess
    # that can be corrected, the last the influence of what only one cloud saw.
    first_width: float = quantity(3.0, unit="m", above=0)
    last_width: float = quantity(0.06, unit="m", above=0)
    # [-] Width of an iteration as part of that of the one before.
    narrowing: float = quantity(0.7, unit="-", low=0.1, high=0.99)
    # [m] Surfels search a partner within this distance at first, and once the width is below a third of it at last.
    first_reach: float = quantity(2.0, unit="m", above=0)
    last_reach: float = quantity(0.4, unit="m", above=0)
    # [deg] Largest angle between the normals of partners.
    max_angle_deg: float = quantity(45.0, unit="deg", above=0, high=90)
    # [-] While the search is wide, one surfel of so many is enough.
    first_stride: int = quantity(3, unit="surfels", low=1)
    # [iterations] At most.
    max_iterations: int = quantity(30, unit="iterations", low=1)
    # [m] It ends when no point moves by more than this (root mean square).
    tolerance: float = quantity(2e-4, unit="m", above=0)
    # [surfels] Smallest number in either cloud, and of pairs.
    min_pairs: int = quantity(40, unit="surfels", low=6)
    # Whether classes weigh in where both clouds have `class_probabilities`.
    classes: bool = True
    # [m] How far along a motion that the geometry does not hold classes are correlated.
    class_span: float = quantity(1.5, unit="m", above=0)


@dataclass(kw_only=True)
class IcpConfig:
    """Open3D's ICP."""

    # Loss on the residual of `point_to_plane`; "tukey" cuts off what moved or was not there before.
    kernel: str = quantity("tukey", choices=KERNELS)
    # [-] Width of the kernel as a part of the correspondence distance of each stage.
    kernel_scale: float = quantity(0.5, unit="-", above=0)
    # [m] Correspondence distance of each stage, coarse to fine: the first bounds the error of the guess that can be
    # corrected, the last the influence of what only one cloud saw.
    max_distances: list[float] = quantity([2.0, 1.0, 0.5], unit="m", above=0, min_length=1)
    # [-] Iterations of each stage at most.
    max_iterations: int = quantity(30, unit="iterations", low=1)
    # [m] The source is thinned to one point a voxel, for speed; 0 keeps all.
    source_voxel: float = quantity(0.4, unit="m", low=0)
    # [m] Radius in which the normals of a target without normals are estimated.
    normal_radius: float = quantity(0.75, unit="m", above=0)


@dataclass(kw_only=True)
class RegistrationConfig:
    """How one cloud is registered to another, and when the result is believed."""

    # `surfaces` is ours; `attributes` is the paper's attribute ICP (S2-c) on points thinned as for Open3D. The others
    # are Open3D's: `point_to_point` is S0-g, Eq. 7; `point_to_plane` needs fewer points; `generalized` is GICP.
    method: str = quantity("surfaces", choices=METHODS)
    surfaces: SurfacesConfig = field(default_factory=SurfacesConfig)
    icp: IcpConfig = field(default_factory=IcpConfig)
    attributes: AttributeIcpConfig = field(default_factory=AttributeIcpConfig)
    # [m] A source point with a target point this near counts as inlier (not with `surfaces`).
    inlier_distance: float = quantity(0.3, unit="m", above=0)
    # [-] Smallest part of the source that must be inliers, where nothing says from where the clouds were seen.
    min_fitness: float = quantity(0.4, unit="-", low=0, high=1)
    # [-] With `surfaces` and a cloud with rings, instead: the largest part of the surfaces which, had they been there,
    # the sensor would have seen, but saw through. Right poses have up to 0.03, on maps 0.06, wrong ones 0.1 and more.
    max_contradiction: float = quantity(0.12, unit="-", low=0, high=1)
    # [points] Smallest number of points in either cloud, and of inliers (not with `surfaces`).
    min_points: int = quantity(100, unit="points", low=6)
    # [-] A motion of which the surfaces feel less than this part, see `constraint`, is taken from the classes or from
    # the guess. A VLP-16 in a hall of 20 m has 0.02 to 0.04, because few of its rays meet the floor.
    min_constraint: float = quantity(0.003, unit="-", low=0, high=1)
    # [m] What is told as standard deviation of such a motion when the guess comes without covariance.
    free_deviation: float = quantity(0.5, unit="m", above=0)
    # [m], [deg] Largest correction of the guess; more is taken for a wrong match.
    max_correction: float = quantity(2.0, unit="m", above=0)
    max_correction_deg: float = quantity(60.0, unit="deg", above=0, high=180)
    # [deg] Turns about the source's z axis, from which it is tried again when fitness is below `retry_fitness` or,
    # where that is known, contradiction above half of `max_contradiction`.
    retry_yaws_deg: list[float] = quantity([-40.0, -20.0, 20.0, 40.0], unit="deg", low=-180, high=180)
    # [-] 0 never tries again.
    retry_fitness: float = quantity(0.75, unit="-", low=0, high=1)

    @property
    def fewest(self) -> int:
        """Smallest number in either cloud, and of pairs, of what the method lays on each other."""
        return self.surfaces.min_pairs if self.method == "surfaces" else self.min_points
