"""`docs/benchmarks.md`, written from what was measured: promises, speed and accuracy beside peers, growth, and how to repeat it."""

from __future__ import annotations

import ast
from collections.abc import Mapping
from textwrap import shorten
from typing import Any

from benchmarks import PARTS, ROOT
from benchmarks.accuracy import LEAST_GROWTH_FRAMES
from benchmarks.estimators import PEERS
from benchmarks.pages.tables import NOT_MEASURED, all_figures, number, promise, table, told
from benchmarks.trust.tables import render as _trust

Found = Mapping[str, Any]

HEAD = """# Benchmarks

Every figure here was measured by `python -m benchmarks`, and this page was written from its JSON (`docs/benchmarks.json`) by
`python -m benchmarks.pages`; a test holds that it says what the JSON says. Times depend on the machine and on its hour; ratios to a
peer in the same run do not, so quote those. What they mean for a constellation is on the [capacity page](capacity.md).

```sh
make test                                     # installs everything, peers included (the extra `bench`)
python -m benchmarks --part all --json F      # measure; --part NAME for one, --size PART.SIZE=VALUE for another size
make bench                                    # measure everything and write this page again
python -m benchmarks.pages --part accuracy    # one part
```

A measurement is no test: the command exits with 0 and says in words which promise was not kept. Measure on an idle machine:
the load average beside each date is what else was running when it began.
"""

ACCURACY = """All start from the same ground calibration of a simulated ST-16 (E Table III, sensor 1) and get the same centroids of
the same named stars: at most {sets} sets of {frames} frames, fewer where a row says so because the peer is slow; two
exposures of twelve stars each, {centroid_sigma_px} px of noise, on one thread.

- **ours, over ours**: Boresight's batch on the same frames, taking turns with the peer set by set, the fastest of each; so the
  ratio is of two times of the same minutes.
- **error / bound**: root mean square error of the eight parameters over their Cramér-Rao bounds, geometric mean; 1 is perfect.
- **detector, corner**: how far the calibrated camera puts a star from where it falls, after the best rotation, root mean
  square over the detector and worst corner. Camera models differ between tools, this does not.
- **f error / claimed**: error of the focal length over the standard deviation that the tool claims for it; 1 is honest.
- **residual**: what the fit leaves, one axis. By it alone the right and the wrong cannot be told apart.
- **memory**: what the work adds to a process of its own that has loaded the library, and in brackets that process's peak.

"""

PROBLEMS = {
    "arcs": "Same problem: eight parameters from the arcs between stars",
    "attitudes": "Larger problem, same optimum: eight parameters, and three angles of attitude a view (bundle adjustment)",
    "poses": "Another problem: camera models of their own, and a whole pose or a plate solution a view",
}

AFTER_ACCURACY = """
General calibrators give every view a translation, and have no switch against it. Stars have no parallax, so a step towards
the sphere that they are put on looks like a longer focal length: the residual falls to the noise and below it, the claimed
deviation is small, and the answer is wrong by hundreds of it. The distance at which the stars are put changes nothing, as
everything scales with it. tetra3rs fits no translation, but leaves the principal point near the middle of the detector.

What is not the same:

"""


def page(document: Mapping[str, Found]) -> str:
    """Write the page."""
    machines, promises, sections = [], [], []
    for name, part in PARTS.items():
        title = f"## {name.capitalize()}: {part.shows}\n\n`python -m benchmarks --part {name}`\n"
        if name not in document:
            machines.append([f"`{name}`", NOT_MEASURED, "", "", ""])
            promises.append([f"`{name}`", "", "", NOT_MEASURED, ""])
            sections.append(f"{title}\n{NOT_MEASURED.capitalize()} yet.\n")
            continue
        machine, found = document[name]["machine"], document[name]["found"]
        load = " ".join(f"{one:g}" for one in machine["load_average"])
        here = f"{machine['processor']}, {machine['cores']} cores, {machine['memory_gb']:g} GB"
        versions = ", ".join(f"{key} {machine['versions'][key]}" for key in ("python", "numpy", "numba", "scipy"))
        at = f"{machine['measured_at'][:16].replace('T', ' ')} UTC"
        machines.append([f"`{name}`", at, here, load, versions])
        promises += [[f"`{name}`", key.replace("_", " "), *promise(one)] for key, one in found["limits"].items()]
        sections.append(f"{title}\n{SECTIONS.get(name, all_figures)(found)}")
    heads = ("part", "began", "machine", "load average 1, 5, 15 min", "versions")
    return "\n".join([
        HEAD,
        "## What measured\n\n" + table(heads, machines, range(5)),
        "## What is promised, and whether it was kept\n\n"
        + table(("part", "promise", "limit", "measured", ""), promises, (0, 1, 4)),
        *sections,
        _scripts(),
    ])  # fmt: skip


def _kernels(found: Found) -> str:
    """Our loops, and what each peer takes beside the one that does its work."""
    rows = [
        [f"`{name}`", number(found["peers"][f"{name}_us_per_frame"]), number(ratio)]
        for name, ratio in found["ratios"].items()
    ]
    peers = table(("peer", "µs a frame", "over ours"), rows)
    unfair = (
        "\nNot the same: the plain NumPy and SciPy peers get R factored for them; `lean` and `ekf` linearise each frame once "
        "where ours does until it rests; the C peer gets the arcs in order and whitened; the matching peer takes one exposure at "
        "a time with one fixed tolerance and no doubt between two stars. `c_fast_math` may reorder sums as ours may; `c` may not.\n"
    )
    return f"{all_figures(found, ('peers', 'ratios'))}\n{peers}{unfair}"


def _accuracy(found: Found) -> str:
    """A table a problem, how time grows, the errors of each parameter, and what is not fair."""
    text, estimators = ACCURACY.format(**found), found["estimators"].values()
    for problem, title in PROBLEMS.items():
        rows = [accuracy_row(row) for row in estimators if row["problem"] == problem]
        text += f"### {title}\n\n" + table(ACCURACY_HEADS, rows) + "\n" if rows else ""
    grown = [
        [row["title"], f"{one['from_frames']:,}", f"{one['to_frames']:,}",
         *(number(one[key]) for key in ("exponent", "us_per_frame", "work_rss_mb"))]
        for row in estimators if (one := row.get("growth")) and one["from_frames"] >= LEAST_GROWTH_FRAMES
    ]  # fmt: skip
    text += (
        "### How time and memory grow with the frames\n\nBoth lengths take turns, the fastest of each counts. Who bears too few "
        "frames for an exponent to mean something is left out.\n\n"
        + table(("estimator", "from frames", "to frames", "exponent", "µs a frame there", "memory there, MB"), grown)
    )
    errors = [
        [row["title"], *(f"{number(e)} ({number(over)})" for e, over in zip(row["error"], row["each_over_bound"], strict=True))]
        for row in estimators if "error" in row
    ]  # fmt: skip
    heads = ("estimator", *(f"`{name}`" for name in found["parameters"]))
    text += "\n### Root mean square error of each parameter, and over its bound\n\n" + table(heads, errors)
    unfair = (f"- {peer.title}: {peer.unfair}\n" for name, peer in PEERS.items() if name in found["estimators"])
    return text + AFTER_ACCURACY + "".join(unfair)


ACCURACY_HEADS = (
    "estimator", "sets × frames", "µs a frame", "ours on the same, µs", "over ours", "memory, MB (peak)", "error / bound",
    "NEES (8)", "detector, px", "corner, px", "over ours", "f error, µm", "f error / claimed", "residual, px",
)  # fmt: skip


def accuracy_row(row: Found) -> list[str]:
    """One estimator."""
    if "us_per_frame" not in row:
        why = row.get("missing") or f"failed: {'; '.join(sorted(set(row['failures'])))}"
        return [row["title"], why, *[""] * (len(ACCURACY_HEADS) - 2)]
    failed = f" ({len(row['failures'])} of {row['sets']} sets failed)" if row["failures"] else ""
    keys = (
        "ours_us_per_frame", "us_per_frame_over_ours", "work_rss_mb", "error_over_bound", "nees", "detector_px", "corner_px",
        "detector_px_over_ours",
    )  # fmt: skip
    cells = [row["us_per_frame"], *map(row.get, keys), row["focal_error_m"] * 1e6, row.get("focal_over_claimed")]
    shown = [number(cell) for cell in (*cells, row.get("rms_px"))]
    shown[3] += f" ({number(row['peak_rss_mb'])})"
    return [row["title"] + failed, f"{row['sets']} × {row['frames']}", *shown]


def _efficiency(found: Found) -> str:
    """A table of the cameras, every estimator beside the plain maximum-likelihood fit."""
    rows = []
    for camera, of in found["cameras"].items():
        for name, one in of["estimators"].items():
            low, high = one["nees_bounds"]
            paired = "" if "over_likelihood" not in one else _with_interval(one, "over_likelihood")
            rows.append(
                [f"`{camera}`: {of['shows']}", name.replace("_", " "), _with_interval(one, "rmse_over_bound", "interval"),
                 paired, f"{one['nees']:.3f}", f"{low:.3f} to {high:.3f}", number(one["worst_parameter"])]
            )  # fmt: skip
    heads = (
        "camera",
        "estimator",
        "error / bound",
        "over maximum likelihood",
        "NEES",
        "its 95 % bounds",
        "worst parameter",
    )
    return (
        f"{found['sets']} sets of {found['frames']} frames a camera, each simulated and fitted with its own model. `maximum "
        "likelihood` is a fit in plain NumPy that shares no line with the product, every attitude a nuisance; intervals are 95 %, "
        "by bootstrap over the sets. An error over the bound that is above one for maximum likelihood too is chance of these "
        "sets: the paired ratio tells what the estimator adds.\n\n" + table(heads, rows)
    )


def _choice(found: Found) -> str:
    """A row a lens and a sensor: what was named, and how far it is off."""
    rows = []
    for camera, of in found["lenses"].items():
        for sensor, one in of["sensors"].items():
            named = one["named"]
            rows.append(
                [f"`{camera}`: {of['shows']}", f"`{sensor}`", ", ".join(f"`{name}` {n}" for name, n in one["chosen"].items()),
                 f"`{named['camera']}`: {', '.join(named['terms'])} ({named['sets']})", str(one["false"]), str(one["missed"]),
                 f"{one['held_out_over_noise']:.3f}", f"{one['own_terms_over_noise']:.3f}"]
            )  # fmt: skip
    heads = (
        "lens", "sensor's camera", "chosen, sets", "named most often (sets)", "false", "missed", "held-out error / noise",
        "of the lens's own terms",
    )  # fmt: skip
    return (
        f"{found['sets']} sets of {found['frames']} frames a lens, {found['stars']} stars a frame, {found['noise_px']:g} px of "
        "noise; each set is searched by a sensor of every camera as `boresight choose` does from its matched stars on. "
        "*False*: a term is named, or the sensor's camera is left, though the same stars without noise do not ask for it; "
        "a plainer camera or term that fits as well is right ([what counts](choice.md#how-often-it-is-wrong)). "
        "*Missed*: the chosen terms leave something "
        "that a single test would find in one set of two. Held-out stars have no noise, so that the error is that of the chosen "
        "camera alone.\n\n" + table(heads, rows, (0, 1, 2, 3))
    )


def _images(found: Found) -> str:
    """Errors of the extractors over the bound, the calibrations by each, and the whole way from hard nights."""
    names = [name for name in next(iter(found["centroids"].values())) if name != "bound_px"]
    rows = [
        [
            ratio,
            f"{of['bound_px']:.4f}",
            *("-" if of[name] is None else number(of[name]["over_bound"]) for name in names),
        ]
        for ratio, of in found["centroids"].items()
    ]
    highest = list(found["centroids"].values())[-1]
    rows.append(["ms an image", "", *("-" if highest[name] is None else number(highest[name]["ms"]) for name in names)])
    cameras = found["calibrations"]
    rows.append(
        [
            "camera off by, px",
            "",
            *("-" if cameras[name] is None else number(cameras[name]["error_px"]) for name in names),
        ]
    )
    night = found["night"]
    of_ways = [name for name in ("as_it_comes", "blends_kept", "without_doubles", "site_unknown") if name in night]
    ways = [
        [name.replace("_", " "), _with_interval(night[name], "rmse_over_bound", "rmse_over_bound_interval"),
         f"{night[name]['nees']:.3f}", "{:.3f} to {:.3f}".format(*night[name]["nees_bounds"]), f"{night[name]['chi2_per_dof']:.3f}",
         f"{night[name]['converged']} of {found['sets']}"]
        for name in of_ways
    ]  # fmt: skip
    through_air = "refraction, " if "site_unknown" in of_ways else ""
    explained = (
        " *As it comes*: the sensor file has the site, and stars that a neighbour in the catalogue draws by over 0.4 of their "
        "sigma take no part. *Blends kept*: they do. *Without doubles*: with `--leave-out-doubles`. *Site unknown*: the sensor "
        "file has no site."
        if through_air
        else ""
    )
    return (
        f"{found['stars']} stars alone, by the ratio of their brightest pixel to the sky's noise: error over the Cramér-Rao bound. "
        "`sep` is the product. The last row is how far a camera is off over the detector, RMS, by the same "
        f"{found['calibration_sets']} clean nights of {found['frames']} images.\n\n"
        + table(("ratio", "bound, px", *(name.replace("_", " ") for name in names)), rows)
        + f"\n{found['sets']} hard nights of {found['frames']} images ({through_air}clouds over a third, trails, "
        f"{night['bad_pixels']:.0f} hot and dead "
        f"pixels, a mirrored sky), from images to parameters, lost in space: {night['stars_per_frame']:.0f} stars an image, "
        f"{number(night['extraction_ms_per_frame'])} ms of one processor for {night['megapixels']:.2f} megapixels. "
        "The bound is that of the "
        f"extractor's own sigmas.{explained}\n\n"
        + table(("nights", "error / bound", "NEES", "its 95 % bounds", "chi² per degree of freedom", "converged"), ways)
    )


def _with_interval(one: Found, key: str, interval: str = "over_likelihood_interval") -> str:
    low, high = one[interval]
    return f"{one[key]:.4f} ({low:.4f} to {high:.4f})"


def _growth(found: Found) -> str:
    rows = [
        [method, f"{row['frames']:,}", number(row["seconds"]), number(row["seconds"] / row["frames"] * 1e6),
         number(row["processor_s"]), number(row["peak_mb"])]
        for method, of_method in found["runs"].items() for row in of_method
    ]  # fmt: skip
    slopes = [
        [method, number(one["exponent"]), ", ".join(map(number, one["between_neighbours"])), told(one, "exponent_beyond_start")]
        for method, one in found["growth"].items()
    ]  # fmt: skip
    matched = [
        [f"{row['frames']:,}", number(row["seconds"]), number(row["seconds"] / row["frames"] * 1e6), number(row["peak_mb"])]
        for row in found["rematch"]
    ]  # fmt: skip
    return (
        "Each is `boresight calibrate FILE.parquet` in a fresh process, starting and reading included.\n\n"
        "![Time and memory of a calibration over its frames](benchmarks-growth.svg)\n\n"
        + table(("method", "frames", "wall, s", "µs a frame", "processor, s", "peak, MB"), rows)
        + "\n"
        + table(("method", "exponent over all sizes", "between neighbours", "beyond starting"), slopes)
        + "\nBeyond starting: of the seconds less those of a process with next to nothing to compute, "
        f"{number(found['empty_s'])} s. These sets have given directions. With stars found again (`rematch`, the command's "
        "default), sets of catalogue stars with times:\n\n"
        + table(("frames", "wall, s", "µs a frame", "peak, MB"), matched)
    )


WHOLES = {
    "given": "directions of the file; the limit holds for this one",
    "small": "the same, small",
    "rematch": "stars found again: the command's default, told without a limit",
}


def _whole(found: Found) -> str:
    """A calibration from file to file, beside the fit in C by both counts of evaluations."""
    rows = []
    for name, words in WHOLES.items():
        one, of_c = found[name], found["given" if name == "rematch" else name]
        over = number(one["total_s"] / of_c["c_fit_s"]) if "c_fit_s" in of_c else NOT_MEASURED
        rows.append(
            [f"`{name}`", words, f"{one.get('frames', found['frames']):,}", told(one, "threads"), number(one["total_s"]),
             told(one, "one_thread_s"), told(of_c, "evaluations"), told(of_c, "c_fit_s"), over,
             told(of_c, "evaluations_of_one_weighing"), told(one, "over_one_weighing")]
        )  # fmt: skip
    heads = (
        "match", "what", "frames", "threads", "whole, s", "whole on one thread, s", "evaluations, both weighings",
        "fit in C on one thread, s", "over C", "evaluations, one weighing", "over C of one weighing",
    )  # fmt: skip
    return (
        table(heads, rows, (0, 1))
        + "\nThe fit in C is the evaluations of A and b of the fit with given directions, and nothing else; a calibration whitens "
        "twice and so fits twice.\n\n" + all_figures(found)
    )


def _spread(found: Found) -> str:
    kill = found["runs"]["one_of_two_killed"]["kill"]
    words = (
        f"The worker at `{kill['worker']}` was killed {number(kill['after_s'])} s after the run began. It had computed "
        f"{kill['groups_done']} groups of pieces and had {kill['groups_in_hand']} in its hands, which others computed."
        if kill["happened"]
        else "**No worker was killed: the run had ended before.**"
    )
    return f"{words}\n\n{all_figures(found)}"


QUEUE = {
    "overhead_ms_per_run": ("thread time", "what workers state under load"),
    "overhead_over_alone_ms_per_run": ("thread time", "the same run in bare processes, as many as workers"),
    "overhead_cpu_ms_per_run": ("processor time", "what workers state under load"),
    "overhead_cpu_over_alone_ms_per_run": ("processor time", "the same run in bare processes, as many as workers"),
}


def _queue(found: Found) -> str:
    limits = {key: f"{limit['limit']:g}" for key, limit in found["limits"].items()}
    rows = [[*words, number(found["calm"][key]), limits.get(key, "-")] for key, words in QUEUE.items()]
    return (
        "A run beyond its computing, without kills. Under load a worker's wall time is stretched by the server's work where both "
        "share cores, so computing is also measured in bare processes, before anything starts. What all processes use beyond "
        "what workers state has no limit: it holds what they use while they wait. The limits are held against the pass without "
        "kills; with kills the overhead holds the starts of what was killed too, and the bare processes compute one run each, "
        "which tells little.\n\n"
        + table(("clock", "beyond", "ms a run", "at most, ms"), rows, (0, 1))
        + f"\n{all_figures(found)}"
    )


CROWDS = {
    "list": "REST API, asking again at once",
    "list_unchanged": "the same, with `If-None-Match`",
    "list_paced": "REST API, once a second each",
    "page": "page of runs, asking again at once",
    "page_paced": "page of runs, once a second each",
    "list_while_writing": "REST API at once, while runs are launched",
    "page_while_writing": "page of runs at once, while runs are launched",
}


def _clients(found: Found) -> str:
    """Every crowd: cold, warm, and while runs are launched."""
    limits, rows = found["limits"], []
    for name, words in CROWDS.items():
        one, most = found[name], limits.get(f"{name}_median", {}).get("limit")
        rows.append(
            [words, *(number(one[key]) for key in ("all_answered_once_after_s", "median_ms")), number(most),
             *(number(one[key]) for key in ("p99_ms", "requests_per_s", "server_us_per_request", "failures")),
             number(one.get("launches"))]
        )  # fmt: skip
    heads = (
        "crowd", "every client answered once after (cold), s", "median, ms", "at most, ms", "99 of 100 within, ms",
        "answers a second", "server, CPU µs a request", "failures", "runs launched meanwhile",
    )  # fmt: skip
    return (
        f"{found['clients']} clients before {found['runs']:,} runs of one sensor. The limits hold for crowds that "
        "ask while nothing is committed. After a commit every person's page is made again, and 200 people who all ask again at "
        "once wait for one another; a launch, half a second after the one before was answered, waits among them.\n\n"
        + table(heads, rows)
        + f"\n{all_figures(found, tuple(CROWDS))}"
    )


def _fleet(found: Found) -> str:
    fleets = {f"{int(size):,} sensors": fleet for size, fleet in found["fleets"].items()}
    paths = next(iter(fleets.values()))["pages"]
    rows = [
        [f"`{path}`", *(number(fleet["pages"][path][key]) for fleet in fleets.values() for key in ("median_ms", "kb"))]
        for path in paths
    ]
    first = ", ".join(f"{number(fleet['first_page_s'])} s of {size}" for size, fleet in fleets.items())
    return (
        f"Median of {found['looks']} looks by one person, something being committed before each, so that every page is made again; "
        f"bytes before compression. Every sensor has {found['runs_each']} runs.\n\n"
        + table(("page", *(f"{size}: {unit}" for size in fleets for unit in ("ms", "kB"))), rows)
        + f"\nThe first page after a start, while the server judges the drift of every sensor for the first time, took {first}.\n"
    )


def _ground(found: Found) -> str:
    """A row an elevation and a way of calibrating; then the real field."""
    rows = [
        [f"{name}°", way, f"{one['focal_ppm']:+.0f} ± {one['focal_ppm_error']:.0f}", f"{one['aspect_ppm']:+.0f}",
         number(one["focal_sigma"]), number(one["with_misfit"]), f"{one['noticed']:.0%}", f"{one['cause']:.0%}"]
        for name, ways in found["elevations"].items() for way, one in ways.items()
    ]  # fmt: skip
    heads = (
        "elevation", "calibrated", "focal length off, ppm", "aspect off, ppm", "RMS in sigmas", "with misfit", "test noticed",
        "cause named",
    )  # fmt: skip
    real = [
        [name, f"{one['focal_mm']:.4f} ± {one['focal_sigma_mm']:.4f}", f"{one['g_y_ppm']:+.0f} ± {one['g_y_sigma_ppm']:.0f}",
         number(one["chi2_per_dof"]), f"{one['adjusted']:.1g}", " ".join(one["sentences"]) or "nothing found"]
        for name, one in found["real_field"].items()
    ]  # fmt: skip
    return (
        f"{found['sets']} sets of {found['frames']} frames an elevation, 0.1 px of noise, upright on a tripod. Where one elevation "
        "is held, air is a scale and an aspect, which the camera takes up whole: no residual shows it. *Unsure air*: the site's "
        "pressure is 20 hPa off and its temperature 10 °C.\n\n" + table(heads, rows, (0, 1))
        + ("\n### The real field\n\n" + table(
            ("directions", "focal length, mm", "aspect, ppm", "chi2 a degree of freedom", "p of refraction, corrected", "finding"),
            real, (0, 5)) if real else "")
    )  # fmt: skip


def _diagnosis(found: Found) -> str:
    rows = [
        [
            one["set"], " and ".join(one["mistakes"]),
            ", ".join(f"`{name}`" for name in one["causes"]) + "".join(f" or `{name}`" for name in one["alternatives"]),
            f"{one['exposures_solved']} of {one['exposures']}", "yes" if one["right"] else "no",
            "yes" if one["wrongly_mended"] else "no", number(one["took_s"]),
            shorten(one["today"].replace("|", "/"), 160, placeholder=" …"),
        ]
        for one in found["inputs"]
    ]  # fmt: skip
    heads = ("set", "mistakes", "named", "exposures solved", "right", "wrongly mended", "s", "without it")
    return (
        f"{found['right']} of {found['of']} are named rightly, {found['wrongly_mended']} mended wrongly. *Without it* is the first "
        f"sentence of a calibration of the same files that asks no diagnosis; {found['solved_today']} of them converge all the "
        "same.\n\n" + table(heads, rows, (0, 1, 2, 7))
    )


def _pointings(found: Found) -> str:
    ways = {"plan": "planned", "chance": f"by chance, median of {found['draws']}", "paper": "the paper's set"}
    rows = [
        [row["sensor"], words, *(number(row[way][key]) for key in ("minutes", "exposures", "weakest_sigma"))]
        for row in found["sensors"] for way, words in ways.items()
    ]  # fmt: skip
    heads = (
        "sensor",
        "pointings",
        "minutes to the gate",
        "exposures to the gate",
        "weakest direction after an hour, σ",
    )
    told = (
        "All begin at ten typical sigmas of each free parameter; the gate asks that the weakest direction be known to half of "
        "one.\n\n" + table(heads, rows, (0, 1))
    )
    if "sets" not in found:
        return told
    of_forecast = [
        [
            row["sensor"],
            f"{number(min(row['forecast']['claimed']))} to {number(max(row['forecast']['claimed']))}",
            f"{number(row['forecast']['errors'])} ± {number(row['forecast']['errors_sigma'])}",
        ]
        for row in found["sensors"]
    ]
    return (
        f"{told}\n\nWhether the forecast of a plan of {found['forecast_minutes']:g} minutes comes true, by {found['sets']} sets a "
        "sensor, simulated and calibrated: the sigmas that they claim, by parameter, and their errors, both over the forecast.\n\n"
        + table(("sensor", "claimed over forecast", "errors over forecast"), of_forecast, (0,))
    )


MISSION = """{checkpoints} answers over {years:g} years of simulated passes. *Alone* is the newest pass by itself, *joint* all
passes until then with every parameter varying by its evidence. Stars: how far the camera puts them from where they fall, root
mean square over the detector. Of the parameters the joint error is {gain} times smaller (geometric mean over the root mean
squares below), of stars {stars} times. NEES a degree of freedom over all is {nees} of the joint answer and {alone_nees} of the
newest pass alone.

"""


def _mission(found: Found) -> str:
    """Errors over time, of each parameter, the steps, and what people would have been asked."""
    text = MISSION.format(
        checkpoints=found["checkpoints"], years=found["years"], gain=number(found["gain_of_parameters"]),
        stars=number(found["gain_of_stars"]),
        nees=number(found["nees_per_dof"]), alone_nees=number(found["alone_nees_per_dof"]),
    )  # fmt: skip
    windows = [
        [
            f"{one['passes']:,}", *(number(one[key]) for key in ("alone_px", "joint_px", "gain", "nees_per_dof")),
            f"{number(one['lower'])} to {number(one['upper'])}", "yes" if one["inside"] else "**no**",
        ]
        for one in found["windows"]
    ]  # fmt: skip
    heads = ("passes", "stars alone, px", "stars joint, px", "times", "NEES / dof", "99 % bounds", "inside")
    errors = [
        [f"`{name}`", number(alone), number(joint), number(alone / joint)]
        for name, alone, joint in zip(found["parameters"], found["alone_sigma"], found["joint_sigma"], strict=True)
    ]
    steps = [
        [
            one["sensor"], f"`{one['parameter']}`", number(one["day"]), "yes" if one["found"] else "**no**",
            "yes" if one["date_inside"] else "**no**", number(one["interval_d"]), one["sentence"],
        ]
        for one in found["steps"]
    ]  # fmt: skip
    return (
        text + table(heads, windows, (6,))
        + "\n### Error of each parameter, typical sigmas\n\n" + table(("parameter", "alone", "joint", "times"), errors)
        + "\n### The step of each sensor, by all passes\n\n"
        + table(("sensor", "parameter", "true day", "found", "date inside", "interval, d", "sentence"), steps, (0, 1, 3, 4, 6))
        + f"\n{found['false_steps_at_checkpoints']} of the steps that {found['checkpoints']} answers told are none.\n"
    )  # fmt: skip


REQUESTS = """\
Missions of the part `mission` by another seed, each pass by itself; the policy walks over them at its usual rules, as its dry
run does. A jump is false where no step is at that pass or the one before it, a drift where what lasts changed by less than three
sigmas of its reference. {told} of {steps} steps were told by the first pass after them. At the false-alarm rate of {rate:g} a pass
{expected} false requests a sensor and year are to be expected.

"""


def _requests(found: Found) -> str:
    """What people would have been asked, and how much of it was false."""
    expected = found["policy"]["nothing changes"]["expected_a_year"]
    text = REQUESTS.format(
        told=found["steps_told"], steps=found["steps"], rate=found["false_alarm_rate"], expected=number(expected)
    )
    asked = [
        [
            name, *(number(one[key]) for key in ("requests_a_year", "false_a_year", "false_jumps_a_year", "displaced_px")),
            ", ".join(f"{count} {kind}" for kind, count in one["kinds"].items()) or "-",
            ", ".join(f"{count} {state}" for state, count in one["states"].items()),
        ]
        for name, one in found["policy"].items()
    ]  # fmt: skip
    heads = (
        "mission",
        "requests a sensor and year",
        "false",
        "false jumps",
        "stars off at a request, px",
        "kinds",
        "passes",
    )
    return text + table(heads, asked, (0, 5, 6))


def _recovery(found: Found) -> str:
    rows = [
        [words, *(number(one[key]) for key in ("sets", "bias", "bias_error", "inside_68", "inside_95"))]
        for words, one in found["recovered"].items()
    ]  # fmt: skip
    heads = ("what", "sets", "mean error, σ", "± of that", "inside 68 %", "inside 95 %")
    return (
        "Errors are over the sigma that each fit tells; of the drift's variance they are over their own scatter, and its "
        "intervals are those of the likelihood.\n\n" + table(heads, rows, (0,))
    )


SECTIONS = {
    "kernels": _kernels, "accuracy": _accuracy, "efficiency": _efficiency, "choice": _choice, "growth": _growth, "whole": _whole,
    "spread": _spread, "queue": _queue, "clients": _clients, "fleet": _fleet, "trust": _trust,
    "ground": _ground, "images": _images, "diagnosis": _diagnosis,
    "pointings": _pointings, "mission": _mission, "requests": _requests, "recovery": _recovery,
}  # fmt: skip


def _scripts() -> str:
    """The modules of `benchmarks/` that have a command of their own, from their own first lines."""
    rows = []
    for path in sorted((ROOT / "benchmarks").glob("*.py")):
        lines = (ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or "").splitlines()
        commands = [line.strip() for line in lines if line.strip().startswith(f"python -m benchmarks.{path.stem}")]
        rows += [[lines[0].rstrip("."), f"`{command}`"] for command in commands]
    return (
        "## Studies of their own\n\nThese take minutes to hours and print what they found.\n\n"
        + table(("shows", "command"), rows, range(2))
    )  # fmt: skip
