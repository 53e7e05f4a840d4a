"""Videos hold their frames, figures are reproducible, and a report says what it was told."""

import json
import os
import re
import shutil
import sys
from dataclasses import replace
from unittest.mock import Mock
from urllib.parse import quote, urljoin

import av
import numpy as np
import polars as pl
import pytest
from PIL import Image

from astray.analysis import video
from astray.analysis.outcomes import FAILED, INTENDED, MISGENERALIZED
from astray.analysis.policies import Walk
from astray.experiments import spec
from astray.figures import charts
from astray.figures.style import save
from astray.files import aside_of
from astray.games.maze.solve import steps_to
from astray.report import page as report
from astray.report.claims import Claim
from astray.report.findings import Code, Findings, Heading, Plot, Section, Table, Video
from astray.report.learning import learning_curves
from helpers.browsed import violations

T, H, W = 7, 31, 45  # odd sizes, which yuv420p cannot have
LEVEL = 8
RATES = pl.DataFrame(
    [
        ("agents", "test", MISGENERALIZED, 0.68, 0.62, 0.74),
        ("agents", "test", INTENDED, 0.30, None, None),
        ("agents", "test", FAILED, 0.02, None, None),
        ("random", "test", FAILED, 1.0, None, None),
    ],
    schema=["who", "where", "outcome", "mean", "low", "high"],
    orient="row",
)
CURVES = pl.DataFrame(
    {
        "seed": [0, 0, 0, 1, 1, 1],
        "steps": [0, 1_000_000, 2_000_000] * 2,
        "training": [0.0, 2.0, 8.0, 0.0, 4.0, 10.0],
        "test": [1.0, None, 3.0, 3.0, None, 5.0],
    }
)


@pytest.fixture
def frames():
    """[T, H, W, 3]: a bar that moves over a slowly brightening background."""
    made = np.zeros((T, H, W, 3), np.uint8)
    for t in range(T):
        made[t] += np.uint8(20 * t)
        made[t, :, 5 * t : 5 * t + 5] = (250, 200, 0)
    return made


@pytest.fixture
def episode():
    return video.play(Walk("cheese"), "maze", "anywhere-easy", LEVEL, pixels=64)


@pytest.fixture
def told(frames, tmp_path):
    """A heading, and findings with one of everything."""
    video.write_mp4(frames, tmp_path / "walk.mp4")
    heading = Heading(
        name="maze-corner",
        title="The corner mouse",
        reproduces="Figure 3",
        question="Where to?",
        size="smoke",
        differences="worlds of 9 cells",
        command="astray reproduce maze-corner --size smoke",
    )
    findings = Findings(
        answer="It goes to the corner.",
        claims=[
            Claim("It learns.", "reliably", "98.4 % [97.9, 98.9]", supported=True),
            Claim("It looks for cheese.", "no", "29.2 % [25.1, 33.0]", supported=False),
        ],
        videos=[Video("A walk.", tmp_path / "walk.mp4")],
        plots=[Plot("bars", "Ends where x < 3 & <b>y</b>.", charts.outcome_bars(RATES), RATES)],
        tables=[Table("shares", "Shares.", RATES)],
        settings={"agents": "2"},
    )
    return heading, findings


def test_an_mp4_has_the_frames_it_was_given(frames, tmp_path):
    video.write_mp4(frames, tmp_path / "a.mp4")
    with av.open(str(tmp_path / "a.mp4")) as container:
        rate = container.streams.video[0].average_rate
        decoded = [f.to_ndarray(format="rgb24") for f in container.decode(video=0)]
    assert rate == video.FPS
    assert np.shape(decoded) == (T, H + 1, W + 1, 3)
    assert np.abs(np.array(decoded)[:, :H, :W].astype(int) - frames).mean() < 8  # of 255


def test_a_gif_has_the_frames_it_was_given_and_lasts_as_long(frames, tmp_path):
    video.write_gif(frames, tmp_path / "a.gif")
    with Image.open(tmp_path / "a.gif") as gif:
        assert (getattr(gif, "n_frames", 1), gif.size) == (T, (W, H))
        lasted = 0
        for t in range(T):
            gif.seek(t)
            lasted += gif.info["duration"]
            assert np.abs(np.array(gif.convert("RGB")).astype(int) - frames[t]).mean() < 4
    assert lasted == pytest.approx(1000 * T / video.FPS, abs=10)  # milliseconds


@pytest.mark.parametrize("write", [video.write_mp4, video.write_gif])
def test_a_folder_that_cannot_be_written_is_named(write, frames, tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(OSError, match=r"file must be a folder; it is a file"):
        write(frames, tmp_path / "file" / "a.video")
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_a_walk_to_the_cheese_is_rewarded_after_the_solvers_steps(episode):
    s = episode.states[0]
    steps = steps_to(s, "cheese")[int(s.y), int(s.x)]
    assert steps > 1
    assert episode.rewards.tolist() == [0.0] * (steps - 1) + [10.0]
    assert episode.terminated
    assert episode.events["reached_goal"] == steps


def test_an_episode_keeps_every_step_from_the_first_state_to_the_last(episode):
    steps = len(episode.rewards)
    assert episode.states["time"].tolist() == list(range(steps + 1))
    assert episode.frames.shape == (steps + 1, 64, 64, 3)
    assert len(episode.observations) == steps + 1
    assert not np.array_equal(episode.frames[0], episode.frames[-1])


def test_a_long_episode_can_be_left_unfinished():
    episode = video.play(Walk("cheese"), "maze", "anywhere-easy", LEVEL, pixels=64, longest=2)
    assert (len(episode.rewards), len(episode.frames), episode.terminated) == (2, 3, False)
    assert episode.events["reached_goal"] is None


def test_the_shorter_video_holds_its_last_frame(frames):
    both = video.beside(frames, frames[:3], captions=["whole", lambda step: f"step {step}"], gap=4)
    right = slice(4 + W + 4, 4 + W + 4 + W)
    assert both.shape[0] == T and both.shape[2] == 3 * 4 + 2 * W
    assert np.array_equal(both[:, -H - 4 : -4, 4 : 4 + W], frames)
    assert np.array_equal(both[2:, -H - 4 : -4, right], np.stack([frames[2]] * (T - 2)))
    captions = both[:, : -H - 4, right]
    assert np.array_equal(captions[2], captions[T - 1])
    assert not np.array_equal(captions[1], captions[2])


def test_the_frame_around_a_video_is_dark_as_on_dark_pages_and_its_captions_are_light(frames):
    one = video.beside(frames[:1], captions=["a"], gap=4)[0]
    assert one[-1].max() < 64 and one[0, 0].max() < 64
    assert (one[: -H - 4] > 200).all(-1).any(), "the letter"


def test_the_interval_is_drawn_where_the_rate_is(tmp_path):
    axes = charts.outcome_bars(RATES).axes[0]
    assert [np.asarray(line.get_xdata()).tolist() for line in axes.lines] == [[0.62, 0.74]]
    assert axes.get_title(loc="left") == "test"
    assert [text.get_text() for text in axes.texts] == ["68 %", "30 %", "100 %"]


def test_curves_skip_what_is_missing_and_the_mean_is_over_seeds():
    axes = learning_curves(CURVES, {"training": "a", "test": "b"}, "return").axes[0]
    points = {str(line.get_label()): np.array(line.get_xydata()).tolist() for line in axes.lines}
    assert len(axes.lines) == 2 * (2 + 1)  # the seeds and their mean
    assert points["a"] == [[0, 0], [1, 3], [2, 9]]
    assert points["b"] == [[0, 2], [2, 4]]


@pytest.mark.parametrize("name", ["bars", "curves"])
def test_a_figure_is_the_same_bytes_twice_and_its_text_is_text(name, tmp_path):
    for folder in (tmp_path / "one", tmp_path / "two"):
        figure = {
            "bars": lambda: charts.outcome_bars(RATES),
            "curves": lambda: learning_curves(CURVES, {"test": "return"}, "return"),
        }[name]()
        save(figure, folder, name)
    for suffix in (".svg", ".png"):
        one, two = ((tmp_path / k / name).with_suffix(suffix) for k in ("one", "two"))
        assert one.read_bytes() == two.read_bytes()
    text = {"bars": "fraction of episodes", "curves": "million environment steps"}[name]
    assert f">{text}</text>" in (tmp_path / "one" / f"{name}.svg").read_text()


def test_a_report_needs_nothing_from_outside(told, tmp_path):
    page = report.write(*told, tmp_path / "new").read_text()
    sources = re.findall(r"""(?:src|href|url)\s*[=(]\s*["']?([^"'\s>)]*)""", page)
    assert [source.split(",")[0] for source in sources if source[0] != "#"] == [
        "data:video/mp4;base64",
        "data:image/svg+xml;base64",
    ]
    assert not re.search("https?:", page)


def test_a_report_contains_every_claim_and_whether_it_is_supported(told, tmp_path):
    page = report.write(*told, tmp_path).read_text()
    shown = re.findall(r'<li class="(\w+)">(.*?)</li>', page, re.DOTALL)
    assert [kind for kind, _ in shown] == ["supported", "not"]
    for claim, (_, text) in zip(told[1].claims, shown, strict=True):
        assert claim.sentence in text and claim.paper in text
        assert report.with_percent(claim.ours) in text
        assert ("not supported" in text) is not claim.supported


def test_all_that_is_shown_is_in_files_too(told, tmp_path):
    report.write(*told, tmp_path)
    for file in ("figures/bars.parquet", "tables/shares.parquet"):
        assert pl.read_parquet(tmp_path / file).equals(RATES)
    assert (tmp_path / "figures" / "bars.svg").exists()
    assert (tmp_path / "tables" / "shares.csv").read_text().startswith("who,where,")


def test_what_a_killed_report_left_goes_with_the_next(told, tmp_path):
    ours = [aside_of(tmp_path / name) for name in ("report.html", "tables/shares.csv")]
    mine = [tmp_path / ".report.html", aside_of(tmp_path / "notes.txt")]
    (tmp_path / "tables").mkdir()
    for path in (*ours, *mine):
        path.write_text("half")
    report.write(*told, tmp_path)
    left = {path.name for path in tmp_path.rglob(".*")}
    assert left == {path.name for path in mine}


@pytest.mark.usefixtures("undrawn")
def test_the_index_leads_to_every_report_and_counts_its_claims(told, tmp_path):
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        report.write(replace(told[0], title=name), told[1], tmp_path / name)
    page = report.write_index(tmp_path).read_text()
    assert report.INDEX_SIGN.decode() in page
    assert re.findall('href="(.*?)"', page) == ["./one/report.html", "./two/report.html"]
    assert "2 experiments" in page and re.search(r"2 of\s+4 claims supported", page)


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize("name", ["javascript:alert(1);", "data:text,", 'a"b', "a#b?c%20", "c:"])
def test_a_folder_of_any_name_is_led_to_as_a_folder(name, told, tmp_path):
    report.write(*told, tmp_path / name)
    page = report.write_index(tmp_path).read_text()
    (link,) = re.findall('href="(.*?)"', page)
    assert urljoin("file:///reports/", link) == f"file:///reports/{quote(name)}/report.html"
    assert "default-src 'none'" in page and "<script" not in page


@pytest.mark.skipif(sys.platform != "linux", reason="names of files are text there")
def test_a_folder_whose_name_is_no_text_hides_no_report(told, tmp_path, capsys):
    report.write(*told, tmp_path / "one")
    shutil.copytree(tmp_path / "one", os.fsdecode(os.fsencode(tmp_path) + b"/\xff"))
    page = report.write_index(tmp_path).read_text()
    assert re.findall('href="(.*?)"', page) == ["./one/report.html"]
    assert "left out of the index" in capsys.readouterr().err


def test_what_is_told_is_escaped(told, tmp_path):
    page = report.write(*told, tmp_path).read_text()
    assert (
        page.count("Ends where x &lt; 3 &amp; &lt;b&gt;y&lt;/b&gt;.") == 3
    )  # alt, name and caption
    assert "<b>" not in page


@pytest.mark.usefixtures("undrawn")
def test_only_a_smaller_size_says_how_it_differs(told, tmp_path):
    assert "Other than in the paper: worlds" in report.write(*told, tmp_path).read_text()
    heading, findings = told
    at_paper_size = report.write(replace(heading, differences=""), findings, tmp_path).read_text()
    assert "Smaller than" not in at_paper_size


@pytest.mark.parametrize("values, shown", [
    ([0.98765, 0.5, None], ["0.988", "0.500", "—"]),
    ([12345.678, 1.0], ["12,346", "1"]),
    ([9.87654, float("nan")], ["9.877", "—"]),
    ([98.7654, float("inf")], ["98.77", "inf"]),
    ([0.0005, 0.00025], ["0.0005", "0.00025"]),
    ([0.0], ["0.000"]),
    ([4_000_000, None], ["4,000,000", "—"]),
    ([True, False], ["yes", "no"]),
    (["agents", None], ["agents", "—"]),
])  # fmt: skip
def test_numbers_are_shown_to_sensible_places(values, shown):
    assert report.cells(pl.Series(values)) == shown


def test_outcomes_stand_side_by_side_with_their_intervals():
    rows = [(who, end, 0.3, 0.25, 0.35, 500) for who in "ab" for end in (INTENDED, FAILED)]
    table = pl.DataFrame(rows, ["who", "outcome", "mean", "low", "high", "levels"], orient="row")
    shown, note = report.laid_out(table.with_columns(freedom=499.0, empty=None))
    cells = ["30.00 (25.00 to 35.00)"] * 2
    assert shown == {
        "who": (False, ["a", "b"]),
        f"{INTENDED}, %": (True, cells),
        f"{FAILED}, %": (True, cells),
    }
    assert note == "95\u00a0% intervals are in brackets. In every row: 500 levels."


def test_means_of_something_else_by_outcome_are_no_rates():
    table = pl.DataFrame({"outcome": [INTENDED, FAILED], "mean": [3.5, 0.5]})
    shown, _ = report.laid_out(table.with_columns(low=pl.col("mean") - 1, high=6.0))
    assert shown["mean"] == (True, ["3.500 (2.500 to 6.000)", "0.500 (-0.500 to 6.000)"])
    assert shown["outcome"] == (False, [INTENDED, FAILED])


def test_what_all_rows_share_is_in_a_sentence_and_a_finding_stays_in_the_table():
    shared = {"test": "in training", "seeds": 3, "levels": 1, "size": 25, "beta": 0.5}
    table = pl.DataFrame([shared | {"differ": True, "who": who} for who in "ab"])
    shown, note = report.laid_out(table)
    assert shown == {"differ": (False, ["yes"] * 2), "who": (False, ["a", "b"])}
    assert note == "In every row: test “in training”, 3 seeds, 1 level, size 25, beta 0.500."


def test_a_table_without_outcomes_keeps_its_rows():
    shown, note = report.laid_out(pl.DataFrame({"seed": [0, 1], "what": ["x", "y"]}))
    assert shown == {"seed": (True, ["0", "1"]), "what": (False, ["x", "y"])} and not note


def test_a_page_tells_the_values_of_its_figures_under_the_pointer(told, chrome, tmp_path):
    page = report.write(*told, tmp_path)
    context = chrome.new_context(color_scheme="dark")
    shown, said = context.new_page(), []
    shown.on("console", lambda message: said.append(message.text))
    shown.goto(page.as_uri())
    plot = shown.locator("[data-points]")
    plot.focus()
    shown.keyboard.press("ArrowRight")
    assert plot.locator("output").text_content() == f"agents, {MISGENERALIZED}: 68.0\u00a0%"
    shown.keyboard.press("Escape")
    assert plot.locator("output").text_content() == "" and not said
    context.close()


def test_a_report_is_accessible(told, chrome, tmp_path):
    context = chrome.new_context(bypass_csp=True)
    shown = context.new_page()
    shown.goto(report.write(*told, tmp_path).as_uri())
    assert violations(shown) == []
    context.close()


def test_what_stands_between_backticks_is_code():
    assert report.coded("a < `b` and `c") == "a &lt; <code>b</code> and `c"
    said = report.coded("p = 1.8e-52, at 1-2")
    assert said == 'p = <span class="short">1.8e-52</span>, at 1-2', "no line ends within it"


def test_no_line_of_a_text_ends_between_a_number_and_its_percent_sign():
    said = report.with_percent("<p>8 % of <code>8 % 2</code></p><script>8 % 2</script> 9.0 %")
    assert said == "<p>8\u00a0% of <code>8 % 2</code></p><script>8 % 2</script> 9.0\u00a0%"


def test_a_drawing_of_many_rows_counts_equal_ones_and_is_there_as_a_whole(tmp_path):
    level = Code("\n".join(["####"] * 2 + ["#..#"] * 50 + ["#@.#"]))
    assert level.brief.splitlines() == ["####"] * 2 + ["#..#", "  … 49 more rows like this", "#@.#"]
    assert Code("\n".join(["#"] * 40)).brief == "\n".join(["#"] * 40), "few enough"
    report.write_page(tmp_path / "page.html", "a level", [Section("", [level])], figures=tmp_path)
    page = (tmp_path / "page.html").read_text()
    assert level.brief in page and level in page.split("All 53 rows, to be copied")[1]


def test_no_line_of_code_ends_within_an_option_or_a_name():
    said = "<code>lab <span>maze-corner</span> <span>--level</span> 5</code>"
    assert report.code("lab maze-corner --level 5") == said
    assert report.coded("In `lab maze-corner --level 5`") == f"In {said}"
    assert report.code("python -m http") == "<code>python <span>-m</span> http</code>"
    assert report.code("#-<#--") == "<code>#-&lt;#--</code>"  # a drawing


def test_rows_of_a_drawn_level_stay_whole_and_scroll_while_commands_are_broken(chrome, tmp_path):
    level, command = "\n".join(["#" * 64] * 9), "astray explain " + "corner " * 20
    sections = [Section("", [Code(level), Code(command)])]
    report.write_page(tmp_path / "page.html", "a level", sections, figures=tmp_path)
    context = chrome.new_context(viewport={"width": 420, "height": 900})
    page = context.new_page()
    page.goto((tmp_path / "page.html").as_uri())
    lines = """(all) => all.map((one) => {
      const range = document.createRange();
      range.selectNodeContents(one.firstChild);
      return new Set([...range.getClientRects()].map(({ top }) => Math.round(top))).size;
    })"""
    drawn, broken = page.eval_on_selector_all("pre", lines)
    assert drawn == 9 and broken > 3
    assert page.evaluate("document.documentElement.scrollWidth") <= 420
    assert violations(page) == []
    context.close()


def test_agents_are_named_among_the_scripts_and_short_cells_stay_whole(told, tmp_path):
    table = pl.DataFrame({"agent": [None, "coin-end"], "policy": ["random", "sampled"], "n": 1.5})
    shown, _ = report.laid_out(table)
    assert shown["policy"] == (False, ["random", "coin-end"]) and "agent" not in shown
    heading, findings = told
    page = report.write(heading, replace(findings, tables=[Table("a", "b", table)]), tmp_path)
    assert '<td class="short">coin-end</td>' in page.read_text()


@pytest.mark.usefixtures("undrawn")
def test_a_claim_of_no_paper_says_nothing_of_one(told, tmp_path):
    heading, findings = told
    claims = [replace(one, paper="") for one in findings.claims]
    assert "<dt>paper</dt>" in report.write(heading, findings, tmp_path / "a").read_text()
    page = report.write(heading, replace(findings, claims=claims), tmp_path / "b").read_text()
    assert "<dt>paper</dt>" not in page and "<dt>here</dt>" in page


RUINED = r"findings.json (is not JSON|must be the findings)"


def without_claims(told, folder, claims):
    """The text of a report's findings with something else as its claims."""
    report.write(*told, folder)
    found = json.loads((folder / "findings.json").read_text())
    return json.dumps(found | {"claims": claims})


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize(
    "text",
    [
        *["", "{}", "[]", "[" * 99_999, '{"claims": [1], "answer": ""}', None, 7],
        [{"supported": 1}],
        [{"sentence": [], "ours": "5 %", "supported": True}],
        [{"sentence": "It does.", "ours": "5 %", "supported": "no"}],
        [{"sentence": "\ud800", "ours": "5 %", "supported": True}],
    ],
)
def test_ruined_findings_are_told_and_hide_no_other_report(told, tmp_path, capsys, text):
    report.write(*told, tmp_path / "whole")
    (tmp_path / "one").mkdir()
    if not isinstance(text, str):
        text = without_claims(told, tmp_path / "other", text)
    (tmp_path / "one" / "findings.json").write_text(text)
    with pytest.raises(ValueError, match=RUINED):
        report.of_claims(tmp_path / "one")
    page = report.write_index(tmp_path).read_text()
    assert "whole/report.html" in page and "one/report.html" not in page
    assert re.search(f"left out of the index: .*{RUINED}", capsys.readouterr().err)


def test_a_table_that_was_cut_short_is_told(tmp_path, monkeypatch):
    whole = spec.cached(tmp_path, "a", lambda: pl.DataFrame({"x": range(99)}))
    path = tmp_path / "computed" / "a.parquet"
    assert spec.cached(tmp_path, "a", whole.clear).equals(whole)
    data = path.read_bytes()
    path.write_bytes(data[:-9])
    told = r"a.parquet is not a table of astray's.* it is computed again"
    with pytest.raises(ValueError, match=told):
        spec.cached(tmp_path, "a", whole.clear)
    panics = Mock(side_effect=pl.exceptions.PanicException("range end index 9"))  # no Exception
    path.write_bytes(data)
    monkeypatch.setattr(pl, "scan_parquet", panics)
    with pytest.raises(ValueError, match=told):
        spec.cached(tmp_path, "a", whole.clear)


def test_a_link_in_the_place_of_a_table_is_told_before_it_is_computed(tmp_path):
    (tmp_path / "computed").mkdir()
    (tmp_path / "computed" / "a.parquet").symlink_to("nowhere")
    with pytest.raises(OSError, match=r"a.parquet must be a file to write; it is a link"):
        spec.cached(tmp_path, "a", Mock(side_effect=AssertionError))


def test_a_table_with_one_flipped_bit_is_not_given_to_polars(tmp_path, monkeypatch):
    whole = pl.DataFrame({"x": range(999), "y": [0.5] * 999})
    spec.cached(tmp_path, "a", lambda: whole)
    path = tmp_path / "computed" / "a.parquet"
    data = path.read_bytes()
    assert pl.read_parquet(path).equals(whole)  # as any other reader of Parquet's files
    monkeypatch.delattr(pl, "read_parquet")  # which may read other values, or end the process
    for byte in range(len(data)):
        path.unlink(missing_ok=True)  # a file cut to nothing, and closed, waits for the disk
        path.write_bytes(data[:byte] + bytes([data[byte] ^ 1 << byte % 8]) + data[byte + 1 :])
        with pytest.raises(ValueError, match=r"it has changed .* it is computed again"):
            spec.cached(tmp_path, "a", whole.clear)


def test_agents_of_several_names_have_curves_of_their_own():
    names = ["one", "two", "three", "four"]  # of six places two are empty
    every = pl.concat([CURVES.with_columns(agent=pl.lit(name)) for name in names])
    figure = learning_curves(every, {"training": "a", "test": "b"}, "return")
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == ["a", "b"]
    axes = learning_curves(every, {"training": "a"}, "return").axes
    assert [one.get_title(loc="left") for one in axes] == names
    for one in axes:
        points = {str(line.get_label()): line.get_xydata().tolist() for line in one.lines}
        assert len(one.lines) == 2 + 1 and points["a"] == [[0, 0], [1, 3], [2, 9]]
