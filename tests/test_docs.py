"""The documentation says what is true: links lead somewhere, code runs, commands parse, generated
parts are what would be generated."""

from __future__ import annotations

import importlib.util
import re
import shlex
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import typer
from markdown.extensions.toc import slugify

from coordlog.cli import app

ROOT = Path(__file__).parents[1]
FIXTURES = ROOT / "tests" / "data" / "v1" / "table"
PAGES = {
    str(path.relative_to(ROOT)): path.read_text(encoding="utf-8")
    for path in [ROOT / "README.md", *sorted(ROOT.glob("docs/**/*.md"))]
}
FENCE = re.compile(
    r"^```(?P<language>\w*)(?: title=\"(?P<title>[^\"]+)\")?\n(?P<code>.*?)^```$",
    re.DOTALL | re.MULTILINE,
)
COMMANDS = typer.main.get_command(app).commands  # type: ignore[attr-defined]
INDENTED = re.compile(r"^    coordlog (?P<line>[a-z].*)$", re.MULTILINE)

_spec = importlib.util.spec_from_file_location(
    "generate", ROOT / "docs" / "reference" / "generate.py"
)
assert _spec is not None
assert _spec.loader is not None
generate = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(generate)


def commands(text: str) -> list[list[str]]:
    """Every command line of a page that is meant to be typed, as arguments."""
    lines = [found["line"] for found in INDENTED.finditer(text)]
    return [shlex.split(re.split(r"\s+(?:#|…)", line)[0]) for line in lines]


@pytest.mark.parametrize("page", [str(path.relative_to(ROOT)) for path in generate.pages()])
def test_generated_parts_are_up_to_date(page: str) -> None:
    assert generate.fill(PAGES[page]) == PAGES[page], "run `make schemas`"


def test_what_should_be_generated_is() -> None:
    marked = " ".join(PAGES.values())
    for name in generate.WRITERS:
        assert f"<!-- generated: {name}" in marked


def test_a_generated_part_that_is_out_of_date_is_seen() -> None:
    page = PAGES["docs/reference/file-format.md"]
    assert generate.fill(page.replace("palm to goal", "hand to goal")) == page


@pytest.mark.parametrize("page", PAGES)
def test_every_link_within_leads_somewhere(page: str) -> None:
    text, missing = FENCE.sub("", PAGES[page]), []
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        if target.startswith(("http://", "https://")):
            continue
        name, _, anchor = target.partition("#")
        path = (ROOT / page).parent / name if name else ROOT / page
        headings = (
            re.findall(r"^#+ (.*)$", path.read_text(encoding="utf-8"), re.MULTILINE)
            if anchor and path.is_file()
            else []
        )
        if not path.exists() or (
            anchor and anchor not in {slugify(heading, "-") for heading in headings}
        ):
            missing.append(target)
    assert missing == []


def test_every_page_is_in_the_navigation() -> None:
    navigation = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    for page in PAGES:
        assert page == "README.md" or f": {page.removeprefix('docs/')}\n" in navigation


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A working directory like a reader's, from which Python imports."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    before = set(sys.modules)
    yield tmp_path
    for name in set(sys.modules) - before:
        if str(getattr(sys.modules[name], "__file__", "")).startswith(str(tmp_path)):
            del sys.modules[name]


def write_logs(folder: Path, text: str) -> None:
    """Logs where a page's code expects them: in logs/, and under every name that it says."""
    shutil.copytree(FIXTURES, folder / "logs" / "some")
    for name in re.findall(r"logs/[\w/.-]+\.mcap", text):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(min(FIXTURES.glob("*.mcap")), folder / name)


@pytest.mark.parametrize(
    "page",
    [page for page, text in PAGES.items() if "```python" in text and page != "docs/index.md"],
)
def test_python_code_runs(page: str, folder: Path) -> None:
    """All blocks of a page, one after the other, in one namespace.

    A block with a title is that file, too.
    """
    blocks = [found for found in FENCE.finditer(PAGES[page]) if found["language"] == "python"]
    write_logs(folder, "".join(found["code"] for found in blocks))
    namespace: dict[str, object] = {"__name__": "page"}
    for found in blocks:
        if found["title"]:
            (folder / found["title"]).write_text(found["code"], encoding="utf-8")
        exec(compile(found["code"], page, "exec"), namespace)


@pytest.mark.parametrize("page", [page for page, text in PAGES.items() if commands(text)])
def test_command_lines_parse(page: str) -> None:
    for name, *arguments in commands(PAGES[page]):
        assert name in COMMANDS, f"{page}: there is no `coordlog {name}`"
        wanted = [
            "0" if argument == "SEED" else argument
            for argument in arguments
            if argument not in ("[OPTIONS]", "--help")
        ]
        COMMANDS[name].make_context(name, wanted)


def test_the_command_line_reference_has_every_command_and_option() -> None:
    sections = dict(
        re.findall(
            r"^## `coordlog (\w+)`\n(.*?)(?=^## |\Z)",
            PAGES["docs/reference/command-line.md"],
            re.DOTALL | re.MULTILINE,
        )
    )
    assert sections.keys() == COMMANDS.keys()
    for name, command in COMMANDS.items():
        for parameter in command.params:
            for option in (*parameter.opts, *parameter.secondary_opts):
                assert option in sections[name], f"{name} {option}"
            assert parameter.help, f"{name} {parameter.name} says nothing about itself"
            assert parameter.help in sections[name]


def test_a_robot_of_ones_own_goes_the_whole_way(folder: Path) -> None:
    """The commands of the page, in order, with fewer episodes and updates."""
    page = PAGES["docs/own-robot.md"]
    for found in FENCE.finditer(page):
        if found["title"]:
            (folder / found["title"]).write_text(found["code"], encoding="utf-8")
    typed = [
        " ".join(words)
        for words in commands(
            page.partition("## From the command line")[2].partition("## From Python")[0]
        )
    ]
    extra = {"train": " --eval-every 0 --set network.hidden=[32,32]", "view": " --save desk.rrd"}
    assert [line.split()[0] for line in typed][:6] == [
        "record",
        "check",
        "train",
        "record",
        "smooth",
        "view",
    ]
    for line in typed[:6]:
        short = re.sub(r"--(episodes|updates) \d+", r"--\1 3", line) + extra.get(
            line.split()[0], ""
        )
        assert app(shlex.split(short), standalone_mode=False) in (None, 0)
    assert (
        len(list(folder.glob("logs/desk/*.mcap")))
        == len(list(folder.glob("smoothed/desk/*.mcap")))
        == 3
    )
    assert (folder / "runs/desk/policy.safetensors").exists()
    assert len(list(folder.glob("evaluation/desk/desk-test-*.mcap"))) == 3
    assert (folder / "desk.rrd").stat().st_size > 10_000
