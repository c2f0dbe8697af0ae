"""What is told of a history on its way: every point once, few at a time, whatever happened to the reports between."""

import itertools
import time
from dataclasses import replace

import numpy as np
import orjson
import pytest
from hypothesis import given
from hypothesis import strategies as st

from boresight.calibration.calibration import Calibration, History
from boresight.workers.link import LINE_EVERY_S, POINTS_AN_EVENT, ProgressInbox, Report, encoded, points_after, thinned

HELD = (7, 1)


def make_history(frames: list[int]) -> History:
    return History(
        frame=frames,
        parameters=[[float(frame), 0.0] for frame in frames],
        sigma=[[1.0 / frame, None] for frame in frames],
        tail_rms_rad=[2.0 * frame for frame in frames],
        aggregate_rms_rad=[3.0 * frame for frame in frames],
        nis=[6.0] * len(frames),
        nis_dof=[3] * len(frames),
    )


def report(frames: list[int], fraction: float = 0.5, held: tuple[int, int] = HELD) -> Report:
    partial = encoded(Calibration(status="running", history=make_history(frames) if frames else None))
    return Report(*held, fraction, f"frame {frames[-1:]}", 1.0, partial)


@given(st.lists(st.integers(1, 400), min_size=1, max_size=12), st.data())
def test_points_follow_one_another_whichever_reports_were_replaced(steps: list[int], data: st.DataObject) -> None:
    reports, told, last = ProgressInbox(), [], None
    for end in itertools.accumulate(steps):
        reports.hear(report(thinned(make_history(list(range(1, end + 1)))).frame))
        if end == sum(steps) or data.draw(st.booleans()):
            for held, newest in reports.take({HELD}).items():
                points = reports.news(held, newest).history
                assert points["after"] == last
                assert points["frame"][-1] == end
                assert len(points["frame"]) <= POINTS_AN_EVENT
                told += points["frame"]
                last = end
    assert told == sorted(set(told))
    assert told[0] == 1


def test_every_column_has_a_value_for_every_frame_told() -> None:
    points = points_after(make_history(list(range(1, 1001))), 400)
    frames = points["frame"]
    assert (frames[0], frames[-1]) == (401, 1000)
    assert [row[0] for row in points["parameters"]] == frames
    assert points["tail_rms_rad"] == [2.0 * frame for frame in frames]
    assert points["nis_per_dof"] == [2.0] * len(frames)
    assert points_after(replace(make_history([1, 2]), nis=[], nis_dof=[]), None).keys() == points.keys() - {
        "nis_per_dof"
    }
    assert points["aggregate_rms_rad"] == [3.0 * frame for frame in frames]


def test_the_innovations_so_far_are_the_mean_over_all_points_before() -> None:
    history = replace(make_history([1, 2, 3]), nis=[3.0, None, 9.0], nis_dof=[3, 0, 3])
    assert points_after(history, 2)["nis_per_dof"] == [2.0]
    assert np.isnan(np.array(points_after(replace(history, nis_dof=[0, 0, 0]), 2)["nis_per_dof"], float)).all()


def test_nothing_new_and_no_history_are_told_as_nothing() -> None:
    reports = ProgressInbox()
    assert reports.news(HELD, report([])).history is None
    assert reports.news(HELD, report([1, 2])).history["frame"] == [1, 2]
    assert reports.news(HELD, report([1, 2])).history is None
    assert reports.news(HELD, report([1])).history["after"] is None  # it began again


def test_a_report_is_read_from_its_bytes_once(monkeypatch: pytest.MonkeyPatch) -> None:
    read, loads = [], orjson.loads
    monkeypatch.setattr("boresight.workers.link.orjson.loads", lambda text: read.append(text) or loads(text))
    heard = report([1, 2])
    assert ProgressInbox().news(HELD, heard).history["frame"] == [1, 2]
    assert heard.progress("2026")["partial"]["status"] == "running"
    assert len(read) == 1


def test_another_attempt_is_told_from_its_start() -> None:
    reports = ProgressInbox()
    reports.hear(report([1, 2]))
    for held, newest in reports.take({HELD}).items():
        reports.news(held, newest)
    again = (7, 2)
    reports.hear(report([1, 2], held=again))
    ((held, newest),) = reports.take({again}).items()
    assert reports.news(held, newest).history["frame"] == [1, 2]


def test_the_log_gets_a_line_a_twentieth_and_never_two_within_two_seconds(monkeypatch: pytest.MonkeyPatch) -> None:
    reports, now_s, lines = ProgressInbox(), 100.0, []
    monkeypatch.setattr(time, "monotonic", lambda: now_s)
    for step in range(1, 101):
        now_s += LINE_EVERY_S / 4
        lines += reports.lines({HELD: report([step], step / 100)}).values()
    assert (lines[0].message, lines[0].numbers) == ("1 %: frame [1]", {"fraction": 0.01, "elapsed_s": 1.0})
    assert [line.numbers["fraction"] for line in lines[1:]] == [percent / 100 for percent in range(5, 101, 5)]
    now_s += 1.0
    assert reports.lines({HELD: report([100], 1.0)}) == {}
