"""README and reference tell what is there and nothing that is not: commands, nouns, contracts, paths, dependencies."""

import re
import tomllib
from collections.abc import Iterator
from pathlib import Path

import click
import pytest

from boresight.calibration.options import OPTIONS
from boresight.cameras import CAMERA_MODELS
from boresight.cameras.model import FAR_TYPICAL_SIGMAS
from boresight.cli import main
from boresight.cli.remote import API_KEY
from boresight.console.access.tables import ROLES
from boresight.console.operation import PREFIX
from boresight.console.routes import NOUNS, routers
from boresight.figures import FIGURES
from boresight.settings import SETTINGS
from boresight.site import SITE_FIELDS
from boresight.telemetry.declarations import DECLARATIONS
from boresight.telemetry.schema import OPTIONAL_COLUMNS, REQUIRED_COLUMNS

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "backend" / "boresight"
README = (ROOT / "README.md").read_text()
REFERENCE = {path.stem: path.read_text() for path in (ROOT / "docs" / "reference").glob("*.md")}
DECLARED = tomllib.loads((ROOT / "pyproject.toml").read_text())
PROJECT, GROUPS = DECLARED["project"], DECLARED["dependency-groups"]
STATUSES = ("converged", "max_iterations", "rank_deficient", "diverged", "too_few_stars")
SENSOR_FIELDS = (
    "name", "detector", "rows", "columns", "pixel_pitch_m", "camera_model", "parity", "centroid_sigma_px", "initial",
    "typical_sigma", "free", "magnitude_limit", "readout", "mode", "line_time_s", "axis", "corrected", "declared",
    *DECLARATIONS, "site", *SITE_FIELDS,
)  # fmt: skip


def _commands(group: click.Group, words: tuple[str, ...] = ("boresight",)) -> Iterator[str]:
    for name, command in group.commands.items():
        if isinstance(command, click.Group):
            yield from _commands(command, (*words, name))
        if not isinstance(command, click.Group) or command.invoke_without_command:
            yield " ".join((*words, name))


def _packages() -> set[str]:
    extras = (*PROJECT["optional-dependencies"].values(), *GROUPS.values())
    return {re.match(r"[A-Za-z0-9-]+", name)[0] for group in (PROJECT["dependencies"], *extras) for name in group}


def test_the_readme_is_short():
    assert len(README.splitlines()) <= 200


def test_the_reference_says_from_where_on_a_change_is_far():
    (row,) = (line for line in REFERENCE["numbers"].splitlines() if line.startswith("| change / typical σ |"))
    assert f"Beyond {FAR_TYPICAL_SIGMAS:g}:" in row


def test_the_reference_names_no_setting_that_does_not_exist():
    told = README + "".join(REFERENCE.values())
    named = set(re.findall(r"(?<!_)BORESIGHT_[A-Z0-9_]+", told))  # a shell's completion has _BORESIGHT_COMPLETE
    assert named <= {API_KEY, *(setting.variable for setting in SETTINGS)}


def test_the_reference_names_exactly_the_commands_there_are():
    told = {
        command
        for command in _commands(main)
        if re.search(rf"^\| `{re.escape(command)}[ `]", REFERENCE["commands"], re.MULTILINE)
    }  # fmt: skip
    rows = re.findall(r"^\| `boresight ", REFERENCE["commands"], re.MULTILINE)
    assert told == set(_commands(main))
    assert len(rows) == len(told)


def test_the_reference_names_exactly_the_nouns_of_the_api():
    paths = [route.path for noun in NOUNS for router in routers(noun) for route in router.routes]
    nouns = {"/" + re.split("[/:]", path.removeprefix(PREFIX))[1] for path in paths}
    told = {
        noun
        for row in re.findall(r"^\| (`/[^|]*) \|", REFERENCE["rest"], re.MULTILINE)
        for noun in re.findall("`(.*?)`", row)
    }
    assert told == nouns
    assert PREFIX in REFERENCE["rest"]


@pytest.mark.parametrize(
    "word",
    [
        *(f"`{name}`" for name in CAMERA_MODELS),
        *(f"`{name}`" for model in CAMERA_MODELS.values() for name in model.parameter_names),
        *(f"`{name}`" for name in FIGURES),
        *(f"`{name}`" for name in (*ROLES, *STATUSES, *SENSOR_FIELDS, *REQUIRED_COLUMNS, *OPTIONAL_COLUMNS)),
    ],
)
def test_the_reference_names_every_word_of_the_contracts(word):
    assert any(word in text for text in REFERENCE.values())


@pytest.mark.parametrize(
    ("option", "words"), [(name, tuple(OPTIONS[name].words)) for name in ("method", "variant", "match")], ids=str
)
def test_the_reference_names_every_choice_of_a_calibration(option, words):
    (row,) = re.findall(r"^\| `boresight calibrate .*", REFERENCE["commands"], re.MULTILINE)
    assert f"`--{option} {words[0]}`" in row
    assert all(f"`{word}`" in row for word in words[1:])


def test_the_reference_gives_a_reason_for_every_dependency_and_for_no_other():
    told = set(re.findall(r"^\| `([a-z][a-z0-9-]*)` \| .+ \|$", REFERENCE["dependencies"], re.MULTILINE))
    paragraph = REFERENCE["dependencies"].partition("For development:")[2].partition("\n\n")[0]
    assert told | set(re.findall(r"`([a-z-]+)`", paragraph)) == _packages()


def _section(title: str) -> str:
    return README.partition(f"\n## {title}\n")[2].partition("\n## ")[0]


def _tree() -> Iterator[tuple[Path, str]]:
    """Yield each path that README's tree names, and the folder under which it is to be found."""
    folder = ROOT
    for line in _section("The tree").split("```\n")[1].splitlines():
        above = PACKAGE if line.startswith(" ") else ROOT
        column, described = line[:26].strip(), line[26:]
        if column and not column.startswith("--"):
            first, *_ = column.split()
            folder = above / first if first.endswith("/") else above
        nouns = re.findall(r"(?:^|  )([a-z_]+)(?=  |;|$)", described) if not column else []
        paths = re.findall(r"(?<![\w/])[\w.*][\w.*/]*(?:/|\.(?:py|toml|lock))(?!\w)", line)
        yield from ((above if name in column else folder, name) for name in (*paths, *nouns))


def test_each_path_of_the_tree_stands_there_and_each_folder_of_the_package_in_the_tree():
    named = list(_tree())
    assert [(folder, name) for folder, name in named if not any(folder.rglob(name.rstrip("/")))] == []
    told = {path.resolve() for folder, name in named for path in folder.glob(name.rstrip("/"))}
    folders = {path.parent for path in PACKAGE.glob("*/*.py")} | {path.parent for path in PACKAGE.glob("*/*/*.py")}
    assert folders - told == set()


@pytest.mark.parametrize(
    "table", [_section("Where a new thing goes"), REFERENCE["where-what-happens"]], ids=["goes", "happens"]
)
def test_what_happens_or_goes_somewhere_stands_there(table):
    for row in re.findall(r"^\| (?!What|New|--).*$", table, re.MULTILINE):
        words = re.findall(r"`([^`]+)`", row.split(" | ")[1])
        names = [word for word in words if "." in word or "/" in word]
        paths = [
            (ROOT if (ROOT / name.split("/")[0]).is_dir() else PACKAGE) / name for name in names if "<" not in name
        ]
        text = "".join(path.read_text() for path in paths if not path.is_dir())
        assert [word for word in words if word not in names and not re.search(rf"\b{word}\b", text)] == [], row


def _stands(name: str) -> bool:
    """Whether there is a file or a folder whose path ends so."""
    return (ROOT / name).exists() or any(
        (ROOT / top).is_dir() and any((ROOT / top).rglob(name.rstrip("/"))) for top in ("backend", "frontend", "tests")
    )


def _is_module(name: str) -> bool:
    """Whether a dotted name is a module of the package, or something in one."""
    module, _, last = name.rpartition(".")
    path = (PACKAGE / module.replace(".", "/")).with_suffix(".py")
    return (
        _stands(f"boresight/{name.replace('.', '/')}")
        or _stands(f"boresight/{name.replace('.', '/')}.py")
        or (path.exists() and re.search(rf"\b{last}\b", path.read_text()) is not None)
    )


def test_each_file_and_module_that_a_document_names_stands_there():
    missing = []
    # Decision 62 names what was deleted, and artefacts are what a command makes.
    pages = {*ROOT.glob("docs/*.md"), *ROOT.glob("backend/decisions/*.md")} - {*ROOT.glob("backend/decisions/0062-*")}
    for page in sorted(pages):
        words = [word.removeprefix("boresight.") for word in re.findall(r"`([\w./-]+)`", page.read_text())]
        files = [word for word in words if re.fullmatch(r"(?:[\w-]+/)*[\w-]+(?:/|\.(?:py|js|css|html|md))", word)]
        names = [word for word in words if re.fullmatch(r"[a-z_]+(?:\.\w+)+", word) and word not in files]
        missing += [(page.name, name) for name in files if not name.startswith("artefacts/") and not _stands(name)]
        missing += [
            (page.name, name) for name in names if (PACKAGE / name.split(".")[0]).is_dir() and not _is_module(name)
        ]
    assert missing == []
