import matplotlib
import numpy as np
import pytest
import umsgpack
from hypothesis import given, settings
from hypothesis import strategies as st
from naraha.systems.display import colours
from naraha.systems.display.colours import PALETTES, UNKNOWN, ColourScale, for_meshcat, height_colours, set_colour
from naraha.systems.errors import ConfigError, InputError
from naraha.systems.hazards.classes import CLASSES, class_colours, class_named
from pydrake.geometry import Meshcat, Rgba, Sphere

SCALES = [colours.HEIGHT, colours.INTENSITY, colours.NIR, colours.TEMPERATURE, colours.DOSE_RATE]


def scale(low=0.0, high=1.0, palette="grey", **options):
    return ColourScale(title="quantity", low=low, high=high, palette=palette, **options)


@pytest.mark.parametrize("name", ["viridis", "inferno"])
def test_the_tables_are_near_the_maps_whose_names_they_bear(name):
    t = np.linspace(0, 1, 257)
    np.testing.assert_allclose(
        PALETTES[name](t).T, matplotlib.colormaps[name](t)[:, :3], atol=0.075
    )  # straight between nine samples


@pytest.mark.parametrize("name", list(PALETTES))
def test_a_palette_gives_a_share_of_each_primary_for_every_value(name):
    rgb = PALETTES[name](np.linspace(0, 1, 1001))
    assert rgb.shape == (3, 1001)
    assert rgb.min() >= 0
    assert rgb.max() <= 1


@pytest.mark.parametrize("name", ["grey", "viridis", "inferno"])
def test_more_is_lighter(name):
    lightness = np.array([0.2126, 0.7152, 0.0722]) @ PALETTES[name](np.linspace(0, 1, 101)) ** 2.2
    assert (np.diff(lightness) > 0).all()


def test_heights_go_from_blue_at_the_floor_to_red_at_two_metres():
    low, middle, high = height_colours(np.array([0.0, 1.0, 2.0], np.float32)).T.astype(int)
    assert low.argmax() == 2
    assert middle.argmax() == 1
    assert high.argmax() == 0
    np.testing.assert_array_equal(height_colours(np.array([-1.0, 5.0])).T, [low, high])


def test_a_colour_that_is_set_is_the_one_that_an_object_is_made_with(read_scene):
    meshcat, colour = Meshcat(), Rgba(0.5, 0.2, 0.02, 0.5)
    meshcat.StartRecording(frames_per_second=10.0)
    meshcat.SetObject("ball", Sphere(0.1), colour)
    set_colour(meshcat, "ball", colour, 0.3)
    meshcat.PublishRecording()
    ((frame, light),) = read_scene(meshcat).turns["ball/<object>"]
    assert frame == 3
    # What an object is made with is as a screen has it (sRGB).
    np.testing.assert_allclose(light, [0.2140, 0.0331, 0.02 / 12.92], atol=1e-4)
    live = umsgpack.unpackb(meshcat._GetPackedProperty("ball", "color"))["value"]
    np.testing.assert_allclose(live, [*light, 0.5])


def test_what_is_not_known_has_a_colour_of_its_own():
    rgb = colours.TEMPERATURE.colours(np.array([[20.0], [np.nan]], np.float32))
    assert rgb.dtype == np.uint8
    assert tuple(rgb[:, 1]) == UNKNOWN
    assert tuple(rgb[:, 0]) != UNKNOWN


def test_values_outside_have_the_colours_of_the_ends():
    np.testing.assert_array_equal(scale(2, 3).fraction(np.array([-np.inf, 2, 2.25, 3, np.inf])), [0, 0, 0.25, 1, 1])


def test_equal_ratios_are_equally_far_apart_in_a_logarithmic_scale():
    fractions = scale(0.1, 1000, log=True).fraction(np.array([-1.0, 0.0, 0.1, 1, 10, 100, 1000, 1e5, np.nan]))
    np.testing.assert_allclose(fractions, [0, 0, 0, 0.25, 0.5, 0.75, 1, 1, np.nan], atol=1e-12)


def test_no_points_have_no_colours():
    assert colours.NIR.colours(np.zeros((0, 1), np.float32)).shape == (3, 0)


@pytest.mark.parametrize("one", SCALES, ids=lambda one: one.title)
def test_the_stops_of_a_legend_are_the_colours_of_the_points(one):
    steps = np.linspace(0, 1, 5)
    values = one.low * (one.high / one.low) ** steps if one.log else one.low + steps * (one.high - one.low)
    assert one.stops(5) == ["#{:02x}{:02x}{:02x}".format(*rgb) for rgb in one.colours(values).T]


@settings(deadline=None)
@given(st.floats(-1e3, 1e3), st.floats(1e-3, 1e4), st.integers(3, 8))
def test_ticks_are_few_in_order_and_where_their_numbers_are(low, span, most):
    one = scale(low, low + span)
    ticks = one.ticks(most)
    places, values = np.array([at for at, _ in ticks]), np.array([float(text) for _, text in ticks])
    assert 1 <= len(ticks) <= most
    assert (np.diff(places) > 0).all()
    np.testing.assert_allclose(one.low + places * span, values, atol=2e-5 * (abs(low) + span))


def test_ticks_are_round_numbers():
    assert [text for _, text in colours.TEMPERATURE.ticks()] == ["20", "40", "60", "80"]
    assert [text for _, text in colours.HEIGHT.ticks(5)] == ["0", "0.5", "1", "1.5", "2"]
    assert [text for _, text in colours.DOSE_RATE.ticks()] == ["0.1", "1", "10", "100"]
    assert [text for _, text in scale(1, 4002).ticks(3)] == ["2000", "4000"]
    assert [text for _, text in scale(2, 8, log=True).ticks()] == ["2", "4", "6", "8"]
    assert len(scale(1e-9, 1e9, log=True).ticks(5)) <= 5


def test_meshcat_brightens_the_colours_back_to_what_they_were():
    given_rgb = np.arange(256, dtype=np.uint8)[None].repeat(3, axis=0)
    linear = for_meshcat(given_rgb) / 255.0
    shown = 255 * np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    assert np.abs(shown - given_rgb)[:, 64:].max() < 3  # eight bits are coarse in the dark
    assert np.abs(shown - given_rgb).max() < 8


@pytest.mark.parametrize(
    "bad",
    [{"palette": "jet"}, {"low": 1.0}, {"low": 2.0}, {"high": np.nan}, {"high": np.inf}, {"low": 0.0, "log": True}],
)
def test_a_scale_that_makes_no_sense_is_refused(bad):
    with pytest.raises(ConfigError):
        scale(**bad)


def test_classes_are_numbered_by_their_place_and_told_apart():
    assert [one.id for one in CLASSES] == list(range(len(CLASSES)))
    assert [one.name for one in CLASSES] == ["other", "water", "heat", "source"]
    rgb = np.array([one.colour for one in CLASSES], float)
    apart = np.linalg.norm(rgb[:, None] - rgb[None], axis=2)
    assert apart[~np.eye(len(CLASSES), dtype=bool)].min() > 80


def test_labels_have_the_colours_of_their_classes():
    water, heat = class_named("water"), class_named("heat")
    rgb = class_colours(np.array([[2], [1], [2]], np.uint8))
    np.testing.assert_array_equal(rgb.T, [heat.colour, water.colour, heat.colour])
    assert class_colours(np.zeros((0, 1), np.uint8)).shape == (3, 0)


@pytest.mark.parametrize("labels", [[0, 4], [-1], [1.5], [np.nan]])
def test_an_unknown_label_is_refused(labels):
    with pytest.raises(InputError, match="unknown class"):
        class_colours(np.array(labels))
    with pytest.raises(InputError, match="other, water, heat, source"):
        class_named("lava")
