"""What the documents name exists: files, links, make targets and commands."""

import re
from importlib import import_module
from pathlib import Path

import pytest

from vemlight.commands.cli import main
from vemlight.renderer.pass_table import PASSES

ROOT = Path(__file__).parents[1]
PAGES = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/*.md"), ROOT / "proto" / "README.md"])
LINK = re.compile(r"\]\(([^)#\s]+)(?:#[^)]*)?\)")
NAMED_FILE = re.compile(r"`((?:services|tests|bench|docs|proto|replay_data|deploy)/[\w./*-]*)`")
NAMED_COMMAND = re.compile(r"(?<![\w./-])vemlight ([a-z]+)\b")
NAMED_TARGET = re.compile(r"(?:`|^)make ([a-z-]+)", re.MULTILINE)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page):
    links = [link for link in LINK.findall(page.read_text()) if "://" not in link]
    assert [link for link in links if not (page.parent / link).exists()] == []


def anchors(page: Path) -> set[str]:
    """Of a page's headings, as GitHub makes them."""
    headings = re.findall(r"^#+ (.*)$", re.sub(r"```.*?```", "", page.read_text(), flags=re.DOTALL), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_to_headings(page):
    links = re.findall(r"\]\(([^)#\s]*)#([^)]+)\)", page.read_text())
    own = [(page.parent / link if link else page, anchor) for link, anchor in links if "://" not in link]
    wrong = [f"{target.name}#{anchor}" for target, anchor in own if anchor not in anchors(target)]
    assert wrong == []


@pytest.mark.parametrize("page", [page for page in PAGES if page.name != "CHANGELOG.md"], ids=lambda page: page.name)
def test_named_files_exist(page):
    assert [name for name in NAMED_FILE.findall(page.read_text()) if not any(ROOT.glob(name.rstrip("/")))] == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_named_commands_and_targets_exist(page):
    code = " ".join(re.findall(r"`[^`]+`|```.*?```", page.read_text(), re.DOTALL))
    assert set(NAMED_COMMAND.findall(code)) <= {*main.commands}
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    assert set(NAMED_TARGET.findall(page.read_text())) <= targets


def test_the_table_of_passes_is_current():
    page = (ROOT / "docs" / "architecture.md").read_text()
    cells = [(one.name, ", ".join(one.reads), ", ".join(one.writes), one.timer, f"`services/renderer/{one.module}`") for one in PASSES]
    rows = [f"| {' | '.join(row)} |" for row in cells]
    assert "\n".join(rows) in page, "write these rows into docs/architecture.md:\n" + "\n".join(rows)


@pytest.mark.parametrize("name", ["Makefile", "Dockerfile", "CONTRIBUTING.md", "README.md", ".ci/run"])
def test_python_code_outside_modules_imports_what_exists(name):
    for module, member in re.findall(r"from (vemlight[\w.]+) import (\w+)", (ROOT / name).read_text()):
        assert hasattr(import_module(module), member), f"{name}: {module} has no {member}"
