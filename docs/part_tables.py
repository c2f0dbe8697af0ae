"""Tables of `docs/benchmarks.md` for the parts whose figures need words: a whole calibration, spreading, the queue, clients."""  # noqa: INP001 - beside the scripts that use it

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from markdown import NOT_MEASURED, figures, number, table

CROWDS = {
    "list": "REST API, asking again at once",
    "list_unchanged": "the same, with `If-None-Match`",
    "list_paced": "REST API, once a second each",
    "page": "page of runs, asking again at once",
    "page_paced": "page of runs, once a second each",
    "list_while_writing": "REST API at once, while runs are launched",
    "page_while_writing": "page of runs at once, while runs are launched",
}
WHOLES = {
    "given": "directions of the file; the limit holds for this one",
    "small": "the same, small",
    "rematch": "stars found anew: the command's default, told without a limit",
}


def told(found: Mapping[str, Any], key: str) -> str:
    """A figure, or that it was not measured."""
    return NOT_MEASURED if found.get(key) is None else number(found[key])


def others(found: Mapping[str, Any], shown: Sequence[str]) -> str:
    """Every figure that no table shows."""
    return table(
        ("figure", "value", "unit"), list(figures({key: one for key, one in found.items() if key not in shown})), (0, 2)
    )


def whole(found: Mapping[str, Any]) -> str:
    """A calibration from file to file, beside the fit in C by both counts of evaluations."""
    rows = []
    for name, words in WHOLES.items():
        if (one := found.get(name)) is None:
            rows.append([f"`{name}`", words, NOT_MEASURED, *[""] * 8])
            continue
        of_c = found["given"] if name == "rematch" else one
        frames = one.get("frames", found["frames"])
        rows.append(
            [f"`{name}`", words, f"{frames:,}", told(one, "threads"), number(one["total_s"]), told(one, "one_thread_s"),
             told(of_c, "evaluations"), told(of_c, "c_fit_s"),
             number(one["total_s"] / of_c["c_fit_s"]) if of_c.get("c_fit_s") else NOT_MEASURED,
             told(of_c, "evaluations_of_one_weighing"), told(one, "over_one_weighing")]
        )  # fmt: skip
    heads = (
        "match", "what", "frames", "threads", "whole, s", "whole on one thread, s", "evaluations, both weighings",
        "fit in C on one thread, s", "over C", "evaluations, one weighing", "over C of one weighing",
    )  # fmt: skip
    return (
        table(heads, rows, (0, 1))
        + "\nThe fit in C is the evaluations of A and b of the fit with given directions, and nothing else; a calibration weighs "
        "twice and so fits twice.\n\n" + others(found, ("limits",))
    )


def spread(found: Mapping[str, Any]) -> str:
    """What was killed, in words, and every figure."""
    kill = found["runs"]["one_of_two_killed"].get("kill")
    if kill is None:
        words = f"Whether the kill happened, and what the worker had done until then, was {NOT_MEASURED}."
    elif not kill["happened"]:
        words = "**No worker was killed: the run had ended before.**"
    else:
        words = (
            f"The worker at `{kill['worker']}` was killed {number(kill['after_s'])} s after the run began. It had computed "
            f"{kill['groups_done']} groups of pieces and had {kill['groups_in_hand']} in its hands, which others computed."
        )
    return f"{words}\n\n" + others(found, ())


QUEUE = (
    ("overhead_ms_per_run", "thread time", "what workers state under load"),
    ("overhead_over_alone_ms_per_run", "thread time", "the same run in bare processes, as many as workers"),
    ("overhead_cpu_ms_per_run", "processor time", "what workers state under load"),
    ("overhead_cpu_over_alone_ms_per_run", "processor time", "the same run in bare processes, as many as workers"),
)


def queue(found: Mapping[str, Any]) -> str:
    """Overhead by all its counts, and every figure."""
    limits = found.get("limits", {})
    rows = [
        [clock, beyond, told(found["calm"], key), f"{limits[key]['limit']:g}" if key in limits else "-"]
        for key, clock, beyond in QUEUE
    ]
    return (
        "A run beyond its computing, without kills. Under load a worker's wall time is stretched by the server's work where both "
        "share cores, so computing is also measured in bare processes, before anything starts. What all processes use beyond "
        "what workers state has no limit: it holds what they use while they wait. The limits are held against the pass without "
        "kills; with kills the overhead holds the starts of what was killed too, and the bare processes compute one run each, "
        "which tells little.\n\n"
        + table(("clock", "beyond", "ms a run", "at most, ms"), rows, (0, 1))
        + "\n"
        + others(found, ())
    )


def clients(found: Mapping[str, Any]) -> str:
    """Every crowd: cold, warm, and while runs are launched."""
    limits = found.get("limits", {})
    rows = []
    for name, words in CROWDS.items():
        one = found.get(name, {})
        most = limits.get(f"{name}_median", {}).get("limit")
        rows.append(
            [words, *(told(one, key) for key in ("all_answered_once_after_s", "median_ms")),
             "-" if most is None else number(most),
             *(told(one, key) for key in ("p99_ms", "requests_per_s", "server_us_per_request", "failures")),
             told(one, "launches") if "launches" in one else "-"]
        )  # fmt: skip
    heads = (
        "crowd", "every client answered once after (cold), s", "median, ms", "at most, ms", "99 of 100 within, ms",
        "answers a second", "server, CPU µs a request", "failures", "runs launched meanwhile",
    )  # fmt: skip
    return (
        f"{found.get('clients', '-')} clients before {found.get('runs', 0):,} runs of one sensor. The limits hold for crowds that "
        "ask while nothing is committed. After a commit every person's page is made anew, and 200 people who all ask again at "
        "once wait for one another; a launch, half a second after the one before was answered, waits among them.\n\n"
        + table(heads, rows)
        + "\n"
        + others(found, tuple(CROWDS))
    )


def fleet(found: Mapping[str, Any]) -> str:
    """Every page by the size of the fleet, and the first page after a start."""
    fleets = found["fleets"]
    sizes = list(fleets)
    rows = [
        [f"`{path}`", *(number(fleets[size]["pages"][path][key]) for size in sizes for key in ("median_ms", "kb"))]
        for path in fleets[sizes[0]]["pages"]
    ]
    heads = ("page", *(f"{int(size):,} sensors: {unit}" for size in sizes for unit in ("ms", "kB")))
    first = ", ".join(f"{number(fleets[size]['first_page_s'])} s of {int(size):,}" for size in sizes)
    return (
        f"Median of {found['looks']} looks by one person, something being committed before each, so that every page is made anew; "
        f"bytes before compression. Every sensor has {found['runs_each']} runs.\n\n"
        + table(heads, rows)
        + "\nThe first page after a start, while the server judges the drift of every sensor for the first time, took "
        + f"{first} sensors.\n"
    )
