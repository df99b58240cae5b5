"""PNG and SVG files: whole, repeatable, and with texts as they are."""

import itertools
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest

from bo_tuner.errors import OutputError
from bo_tuner.figures.figure import Axis, Bars, ColorScale, Figure, Heatmap, Line, Panel, Scale
from bo_tuner.figures.matplotlib_renderer import draw, render
from bo_tuner.report.page import write_figure


def figure_of(*elements):
    panel = Panel(x=Axis(label="x"), y=Axis(label="y"), elements=elements)
    return Figure(name="one", title="t", caption="", alternative="", panels=[panel])


@pytest.fixture(scope="module")
def files(full_figure, tmp_path_factory):
    return write_figure(full_figure, tmp_path_factory.mktemp("figure") / "new" / "folder")


def test_files_are_whole(files):
    png, svg = files
    assert (png.name, svg.name) == ("full.png", "full.svg")
    assert png.read_bytes().startswith(b"\x89PNG\r\n")
    assert ElementTree.parse(svg).getroot().tag.endswith("svg")


def test_a_figure_gives_the_same_bytes_again(full_figure, files):
    for file in files:
        assert render(full_figure, file.suffix.removeprefix(".")) == file.read_bytes()


def test_texts_hold_no_markup(full_figure):
    sheet = draw(full_figure)
    assert sheet.axes[0].get_title(loc="left") == "fields, $a_1$ & <b>"
    # With formulas on, this text would be refused.
    panel = Panel(x=Axis(label="$\\broken{"), y=Axis(label="y"), elements=[])
    assert render(Figure(name="a", title="", caption="", alternative="", panels=[panel]), "svg")


def test_the_legend_names_each_element_once(full_figure):
    (legend,) = draw(full_figure).legends
    names = [text.get_text() for text in legend.get_texts()]
    assert names == ["out", "edge", "cut", "band", "line", "points", "limit", "here", "a", "b"]


@pytest.mark.parametrize("names", [["short"], ["a name of some twenty-five letters"] * 13])
def test_a_legend_stays_within_the_sheet(names):
    names = [f"{name} {index}" for index, name in enumerate(names)]
    sheet = draw(figure_of(*(Line(x=[0.0, 1.0], y=[0.0, 1.0], name=name) for name in names)))
    sheet.draw_without_rendering()
    (legend,) = sheet.legends
    extent = legend.get_window_extent()
    assert extent.x0 >= 0.0
    assert extent.x1 <= sheet.bbox.width
    assert len(legend.get_texts()) == len(names)


@pytest.mark.parametrize("high", [60.0, 1.0, 0.09, 0.002, 0.0022, 1e-4, 123456.0])
@pytest.mark.parametrize("panels", [1, 2])
def test_numbers_of_a_horizontal_axis_keep_a_letter_apart(high, panels):
    line = Line(x=[0.0, high], y=[0.0, 1.0])
    panel = Panel(x=Axis(label="x"), y=Axis(label="y"), elements=[line])
    figure = Figure(name="a", title="", caption="", alternative="", panels=[panel] * panels)
    sheet = draw(figure)
    sheet.draw_without_rendering()
    for ax in sheet.axes:
        low, high = ax.get_xlim()
        labels = [t for t in ax.get_xticklabels() if low <= t.get_position()[0] <= high]
        extents = [text.get_window_extent() for text in labels]
        assert len(extents) >= 3
        letter = max(e.width / len(t.get_text()) for e, t in zip(extents, labels, strict=True))
        for left, right in itertools.pairwise(extents):
            assert right.x0 - left.x1 > letter


@pytest.mark.parametrize("high", [8.9, 12.0, 30.0, 1e4])
def test_a_logarithmic_axis_has_some_numbers(high):
    line = Line(x=[0.0, 1.0], y=[8.0, high])
    panel = Panel(x=Axis(label="x"), y=Axis(label="y", scale=Scale.LOG), elements=[line])
    sheet = draw(Figure(name="a", title="", caption="", alternative="", panels=[panel]))
    sheet.draw_without_rendering()
    (ax,) = sheet.axes
    low, high = ax.get_ylim()
    labels = [t.get_text() for t in ax.get_yticklabels() if low <= t.get_position()[1] <= high]
    assert len([text for text in labels if text]) >= 2


@pytest.mark.parametrize(
    ("scale", "x", "edges"),
    [
        (Scale.LINEAR, [1.0, 3.0, 4.0], [0.0, 2.0, 3.5, 4.5]),
        (Scale.LOG, [1.0, 4.0, 16.0], [0.5, 2.0, 8.0, 32.0]),
        (Scale.LOG, [1.0], [np.exp(-0.5), np.exp(0.5)]),
    ],
)
def test_cells_of_a_heatmap_meet_half_way_on_the_axis(scale, x, edges):
    field = np.zeros((2, len(x)))
    element = Heatmap(x=x, y=[0.0, 1.0], z=field, colors=ColorScale(label="z", low=0.0, high=1.0))
    panel = Panel(x=Axis(label="x", scale=scale), y=Axis(label="y"), elements=[element])
    one = Figure(name="one", title="t", caption="", alternative="", panels=[panel])
    (mesh,) = draw(one).axes[0].collections
    np.testing.assert_allclose(mesh.get_coordinates()[0, :, 0], edges)


def test_bars_stand_beside_each_other_or_on_their_base():
    x = [0.0, 1.0]
    (ax,) = draw(figure_of(Bars(x=x, y=[2.0, 3.0]), Bars(x=x, y=[1.0, 5.0]))).axes
    edges = sorted((p.get_x(), p.get_x() + p.get_width()) for p in ax.patches)
    assert all(end <= begin + 1e-12 for (_, end), (begin, _) in itertools.pairwise(edges))
    (ax,) = draw(figure_of(Bars(x=x, y=[2.0, 3.0], base=[1.0, 4.0]))).axes
    tops = [(p.get_y(), p.get_y() + p.get_height()) for p in ax.patches]
    np.testing.assert_allclose(tops, [(1.0, 3.0), (4.0, 7.0)])


def test_a_folder_that_cannot_be_made_is_an_output_error(full_figure, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="cannot be written"):
        write_figure(full_figure, tmp_path / "file" / "folder", ["svg"])


def test_a_link_in_the_place_of_a_file_is_not_followed(tmp_path):
    other = tmp_path / "other"
    other.write_text("somebody else's")
    (tmp_path / "one.svg").symlink_to(other)
    with pytest.raises(OutputError, match="found a symbolic link"):
        write_figure(figure_of(), tmp_path, ["svg"])
    assert other.read_text() == "somebody else's"
