"""Charts show the numbers of their tables, and tell series apart without colour."""

import numpy as np
import polars as pl
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_hex
from matplotlib.figure import Figure

from astray.analysis.outcomes import FAILED, INTENDED, MISGENERALIZED
from astray.figures import charts, hover
from astray.figures.axes import call_places
from astray.figures.grids import FADED, SIGNS, Picture, cells, images
from astray.figures.style import DARK, INK, OTHERS, PAGE, save

VALUES = pl.DataFrame(
    {
        "who": ["a", "b", "a", "b"], "when": [3.0, 3.0, 10.0, 10.0],
        "mean": [0.1, 0.2, 0.3, 0.4], "low": [0.0, 0.1, 0.2, None], "high": [0.2, 0.3, 0.5, None],
    }
)  # fmt: skip


def named(axes):
    return dict(zip(*axes.get_legend_handles_labels()[::-1], strict=True))


def test_parts_of_a_bar_lie_beside_each_other_and_differ_in_hatching():
    ends = pl.DataFrame({"test": "one", "end": [INTENDED, MISGENERALIZED], "mean": [0.75, 0.25]})
    colours = charts.outcome_colours([])
    (axes,) = charts.bars(ends, colours, row="test", part="end", label="").axes
    boxes = [(round(p.get_x(), 2), round(p.get_width(), 2)) for p in axes.patches]
    assert boxes == [(0, 0.25), (0.25, 0.75), (1, 0)]
    assert list(colours) == [MISGENERALIZED, INTENDED, FAILED]
    assert len({p.get_hatch() for p in axes.patches}) == 3


def test_no_bars_are_refused():
    with pytest.raises(ValueError, match="there are no bars to draw; got an empty table"):
        charts.bars(VALUES.clear(), {}, row="who", part="when", label="")


def test_points_have_a_row_each_and_their_intervals():
    (axes,) = charts.points(VALUES.head(2), row="who", label="fraction", at={"": 0}).axes
    assert [tick.get_text() for tick in axes.get_yticklabels()] == ["a", "b"]
    assert axes.get_ylim() == (1.5, -0.5), "the first is on top"
    (ends,) = axes.collections
    assert [s[:, 0].round(6).tolist() for s in ends.get_segments()] == [[0.0, 0.2], [0.1, 0.3]]


@pytest.mark.parametrize("symlog", [None, 2.0])
def test_values_under_the_pointer_are_those_of_the_points_and_not_of_ticks(symlog):
    data = pl.DataFrame({"who": ["a"], "mean": [3.7], "low": [3.1], "high": [14.6]})
    figure = charts.points(data, row="who", label="", symlog=symlog)
    assert [text for *_, text in hover.points(figure)] == ["3.7, a, 95 % interval 3.1 to 14.6"]


@pytest.mark.parametrize("count", [2, 5, 9])
def test_no_two_series_look_alike_without_colour(count):
    data = pl.DataFrame({"who": [f"{k}" for k in range(count)], "x": 1, "mean": 0.5})
    (axes,) = charts.curves(data, x="x", line="who", label="").axes
    looks = {(line.get_marker(), line.get_linestyle()) for line in axes.lines}
    assert len(looks) == count
    assert len({line.get_color() for line in axes.lines}) == min(count, len(OTHERS))


def test_what_has_no_place_is_a_level_line_and_what_has_no_interval_no_band():
    base = pl.DataFrame({"who": ["base rate"], "mean": [0.6]})
    both = pl.concat([VALUES, base], how="diagonal")
    (axes,) = charts.curves(both, x="when", line="who", label="fraction").axes
    assert named(axes)["a"].get_xydata().tolist() == [[3, 0.1], [10, 0.3]]
    assert named(axes)["base rate"].get_ydata() == [0.6, 0.6]
    bands = [np.array(band.get_paths()[0].vertices)[:, 0].tolist() for band in axes.collections]
    assert {max(band) for band in bands} == {10, 3}  # of b, the last has no interval


def test_numbers_are_spaced_evenly_where_that_is_asked_for():
    (axes,) = charts.curves(
        VALUES, x="when", line="who", label="", even=True, whiskers=True, base=["b"]
    ).axes
    assert [tick.get_text() for tick in axes.get_xticklabels()] == ["3.0", "10.0"]
    middles = {round(float(x), 2) for line in axes.lines for x in np.array(line.get_xdata())}
    assert middles == {-0.03, 0.97, 0.03, 1.03}


def test_cells_are_where_their_settings_are_and_missing_ones_empty():
    data = VALUES.head(3).with_columns(what=pl.lit(INTENDED))
    (axes,) = cells(data, {INTENDED: "#000000"}, x="who", y="when", panel="what").axes
    (shown,) = axes.images
    assert np.ma.filled(shown.get_array(), -1).tolist() == [[0.1, 0.2], [0.3, -1]]
    assert [t.get_text() for t in axes.texts] == [
        "10 %", "0 to 20", "20 %", "10 to 30", "30 %", "20 to 50",
    ]  # fmt: skip


def test_a_picture_has_its_highest_row_on_top_and_arrows_in_the_middle_of_cells():
    heat = np.array([[1.0, 2.0], [3.0, 4.0]])
    arrows = np.array([[0, 1]]), np.array([[0.0, 0.0]])
    one = Picture(
        "one", heat=heat, limits=(1, 4), label="value", arrows=arrows, letters={(1, 0): "u"}
    )
    figure = images([[one], []])
    axes = figure.axes[0]
    (letter,) = axes.texts
    assert (letter.get_text(), letter.get_color()) == ("u", INK)  # on what follows a dark theme
    (shown,) = axes.images
    assert tuple(shown.get_extent()) == (0, 2, 0, 2) and shown.origin == "upper"
    assert [c.get_offsets().tolist() for c in axes.collections] == [[[0.5, 1.5]]]
    assert figure.axes[-1].get_ylabel() == "value"


def test_a_name_is_written_as_it_is_given(tmp_path):
    odd = VALUES.with_columns(who=pl.lit("costs $x_{$"))
    save(charts.curves(odd, x="when", line="who", label=""), tmp_path, "odd")
    assert ">costs $x_{$</text>" in (tmp_path / "odd.svg").read_text()


def test_labels_of_lines_that_lie_close_stand_side_by_side():
    shown = Figure().subplots()
    shown.set_xlim(0, 100)
    call_places(shown, {"a": 50, "b": 50, "c": 51, "d": 80, "first": 2, "next": 2, "third": 7})
    at = {text.get_text(): text.xy[0] for text in shown.texts}
    assert at["d"] == 80 and at["c"] == 51 and at["c"] - at["a"] > 2 < at["a"] - at["b"]
    side = {text.get_text(): text.get_ha() for text in shown.texts}
    begin = sorted(at[name] - 2.5 * (side[name] == "right") for name in at)
    assert begin[0] == 2 and min(np.diff(begin)) > 2, "also beside the axis"
    grounds = {to_hex(text.get_bbox_patch().get_facecolor()) for text in shown.texts}
    assert grounds == {PAGE} <= {*DARK}, "they hide curves, in the dark too"


def test_a_part_of_a_value_has_the_colour_of_its_sign_and_is_clear_at_0():
    """So that on a dark page a small part is dark, where a pale colour would be grey."""
    assert FADED[127] == FADED[128] == 0 and FADED[0] == FADED[-1] == 1
    for amount, hue in ((0.4, 0), (0.6, 2)):
        red, _, blue = 255 * np.array(SIGNS(amount))[:3]
        assert abs(red - blue) > 90 and (red, 0, blue)[hue] > 150


@pytest.mark.parametrize("ground", [np.full((40, 80, 3), 90, np.uint8), None])
@pytest.mark.parametrize("opacity", [0.62, FADED])
def test_a_bar_has_the_colours_that_the_map_shows(ground, opacity):
    picture = Picture("", ground, np.array([[-0.5, 0.5]]), (-1, 1), label="x", opacity=opacity)
    figure = images([[picture]])
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    shown = np.asarray(canvas.buffer_rgba())[::-1]

    def seen(axes, *place):
        x, y = axes.transAxes.transform(place).astype(int)
        return shown[y, x, :3].astype(int)

    cells, bar = figure.axes
    assert abs(seen(cells, 0.25, 0.5) - seen(bar, 0.5, 0.25)).max() < 9
    assert abs(seen(cells, 0.75, 0.5) - seen(bar, 0.5, 0.75)).max() < 9


def test_every_reference_line_is_drawn():
    at = {"one": 0.1, "two": 0.2, "three": 0.3, "four": 0.4, "five": 0.5}
    (axes,) = charts.points(VALUES.head(2), row="who", label="fraction", at=at).axes
    lines = {line.get_label(): np.asarray(line.get_xdata())[0] for line in axes.get_lines()}
    assert {name: lines.get(name) for name in at} == at
