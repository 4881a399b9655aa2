"""The documentation: it builds without a warning, shows the code that runs, and its tables and commands are true."""

import ast
import dataclasses
import importlib
import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

import icac_jax
from icac_jax.agents import registry
from icac_jax.cli import main
from icac_jax.cli.commands import train
from icac_jax.settings import options

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "docs" / "hooks"))
excerpts, mathematics, reference, settings_tables = map(
    importlib.import_module, ("excerpts", "mathematics", "reference", "settings_tables")
)

PAGES = [*sorted((ROOT / "docs").rglob("*.md")), ROOT / "README.md", ROOT / "CONTRIBUTING.md"]


def test_excerpts_are_the_code_that_runs():
    shown = excerpts.code("icac_jax.curiosity.nearest.squares")
    assert shown.startswith("def squares(")
    assert "dots(offset, offset)" in shown
    assert '"""' not in shown
    part = excerpts.code("icac_jax.agents.cacla.update", "line 14")
    assert "hyper.beta * td_error**2" in part
    assert "line 11" not in part
    ast.parse(part)
    page = excerpts.on_page_markdown("before\n\n<!-- code: icac_jax.curiosity.nearest.squares -->\n")
    assert "```python\ndef squares(" in page
    assert "icac_jax/curiosity/nearest.py" in page


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("icac_jax.curiosity.itm.nearest_three", ()),
        ("icac_jax.maps.update", ()),
        ("icac_jax.curiosity.itm.update", ("line 99",)),
    ],
)
def test_what_is_no_longer_there_is_not_shown(name, words):
    with pytest.raises(LookupError, match=name):
        excerpts.code(name, *words)


def test_every_equation_and_line_of_the_paper_is_there_with_code():
    text = (ROOT / "docs" / "algorithm.md").read_text()
    assert {int(number) for number in re.findall(r'class="number">\((\d+)\)', text)} == set(range(3, 12))
    for title, last in (("## Algorithm 1", 21), ("## Algorithm 2", 19)):
        section = text.partition(title)[2].partition("\n## ")[0]
        steps = []
        for first, end in re.findall(r'class="step">(\d+)(?:–(\d+))?<', section):
            steps += range(int(first), int(end or first) + 1)
        assert sorted(steps) == list(range(1, last + 1)), title
    for match in excerpts._DIRECTIVE.finditer(text):
        assert excerpts.excerpt(match)


def test_equations_become_mathml_and_a_wrong_one_ends_the_build():
    page = '<p><span class="arithmatex">\\(a_t &lt; b\\)</span> <div class="arithmatex">\\[\\frac{1}{2}\\]</div></p>'
    shown = mathematics.on_page_content(page)
    assert "<msub><mi>a</mi><mi>t</mi></msub><mo>&#x0003C;</mo><mi>b</mi>" in shown
    assert shown.count("<math ") == 2
    assert shown.count('display="block"') == 1
    assert "arithmatex" not in shown
    for wrong in (r"\alhpa", r"\frac{1}", r"\left(a"):
        with pytest.raises(mathematics.PluginError, match="no equation"):
            mathematics.mathml(wrong)


def test_every_option_has_a_row_with_its_default():
    page = settings_tables.on_page_markdown((ROOT / "docs" / "settings.md").read_text())
    rows = {}
    for line in page.splitlines():  # learners share names; the first declaration is that of `all_options`
        if line.startswith("| `--"):
            rows.setdefault(line.split("|")[1].strip(" `"), line)
    assert set(rows) == {"--" + name.replace("_", "-") for name in options.all_options()}
    for name, field in options.all_options().items():
        cells = [cell.strip() for cell in rows["--" + name.replace("_", "-")].split(" | ")]
        assert len(cells) == 8
        assert field.metadata["help"] == cells[1]
        assert field.metadata["source"] == cells[7].rstrip(" |")
        assert cells[3] == settings_tables.declared(field)
    assert "| `0.9` | – | `0.9` |" in rows["--gamma"]
    assert "| `0.1` | `0.573` (planar2), `1` (nico4) | `0.1` |" in rows["--sigma"]
    assert "normalised joints" in rows["--e-max"]
    assert "| `50` | `100` (nico4) | `50` (planar2), `100` (nico4) |" in rows["--goal-reward"]
    assert "| not stated |" in rows["--weight-scale"]
    assert "| `updated` | – | `previous` |" in rows["--variance-order"]
    text = "<!-- default: goal_reward nico4 --> <!-- default: variance_order paper-literal -->"
    assert settings_tables.on_page_markdown(text) == "`100` `previous`"


@pytest.mark.parametrize("name", settings_tables.RECORDS)
def test_the_default_in_the_page_is_what_the_record_gives_in_python(name):
    table, plain = settings_tables.table(name), settings_tables.RECORDS[name]()
    for field in settings_tables.fields_of(name):
        option, value = field.name.replace("_", "-"), settings_tables.shown(getattr(plain, field.name))
        (row,) = [line for line in table.splitlines() if line.startswith(f"| `--{option}` |")]
        assert row.split(" | ")[3] == (f"`{value}`" if value else "–")


def test_every_option_of_a_learner_is_in_one_of_its_tables():
    shown = {field.name for name in settings_tables.RECORDS for field in settings_tables.fields_of(name)}
    for algo in registry.LEARNERS:
        assert set(options.options_of(algo)) <= shown


def test_every_open_point_names_options_that_exist():
    page = (ROOT / "docs" / "open_points.md").read_text()
    for name in re.findall(r"<!-- default: (\w+)", page) + re.findall(r"`--([\w-]+)", page):
        assert name.replace("-", "_") in options.all_options(), name
    literal = {
        name
        for arm in settings_tables.values("sigma", "paper")
        for name, value in options.defaults(arm, "paper-literal").items()
        if value != options.defaults(arm, "paper")[name]
    }
    for name in literal - {"preset", "window"}:  # the window only has to be long enough
        assert f"default: {name}" in page, f"{name} differs between the presets and is not among the open points"


def test_a_public_name_without_documentation_is_found():
    assert reference.all_undocumented() == []
    source = (
        '"""m"""\ndef f():\n  pass\nclass A:\n  """A."""\n  x: int\n  def g(self):\n    pass\n  def _h(self): pass\n'
    )
    assert reference.undocumented(source, "m") == ["m.f", "m.A.x", "m.A.g"]
    fields = 'x: int\n  y: int = param(1, "y")\n  Z: ClassVar[int] = 1\n'
    good = f'"""m"""\nclass A:\n  """A.\n\n  Attributes:\n    x: a number.\n  """\n  {fields}'
    assert reference.undocumented(good, "m") == []
    assert reference.undocumented("x = 1", "m") == ["m"]


def test_every_module_has_a_page_and_every_public_name_a_link():
    written = {page: page.read_text() for page in (ROOT / "docs" / "reference").glob("*.md")}
    tables = "".join(reference.on_page_markdown(text) for text in written.values())
    made = reference.pages()
    for package in reference.packages():
        assert re.search(rf"^::: {re.escape(package)}$", tables, re.M), f"{package} is on no page of the reference"
        for module in reference.modules(package):
            assert made[f"reference/{module}.md"].startswith(f"::: {module}\n")
            assert f"]({module}.md)" in tables, f"no page links to {module}"
            for name in reference.public_names(module):
                assert f'<a id="{module}.{name}"></a>' in tables
                assert f"[`{name}`][{module}.{name}]" in tables
    for name in icac_jax.__all__:
        assert f"| `icac_jax.{name}` |" in tables
    navigation = reference._with_modules([{"Reference": [{"Curiosity": "reference/curiosity.md"}]}], ROOT / "docs")
    ((_, below),) = navigation[0]["Reference"][0].items()
    assert below[0] == "reference/curiosity.md"
    assert {"itm": "reference/icac_jax.curiosity.itm.md"} in below


def test_commands_in_the_pages_exist():
    known = (
        set(options.all_options())
        | {field.name for field in dataclasses.fields(train.Output)}
        | {"help", "help_choices"}
    )
    found = 0
    for page in PAGES:
        for command, rest in re.findall(r"^(?:\$ )?icac ([a-z-]+)(.*)$", page.read_text(), re.M):
            assert command in main.COMMANDS, f"{page.name}: icac {command}"
            if command == "train":
                found += 1
                for option in re.findall(r" --([\w-]+)", rest.partition("#")[0]):
                    assert option.replace("-", "_") in known, f"{page.name}: icac train --{option}"
    assert found >= 5
    targets = re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.M)
    for page in PAGES:
        for target in re.findall(r"^make ([a-z-]+)", page.read_text(), re.M):
            assert target in targets, f"{page.name}: make {target}"


def test_citation():
    facts = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert facts["version"] == icac_jax.__version__
    assert facts["license"] == "Apache-2.0"
    (paper,) = facts["references"]
    assert [author["family-names"] for author in paper["authors"]] == ["Hafez", "Weber", "Wermter"]


def test_the_site_builds_and_needs_nothing_from_elsewhere(tmp_path):
    """Strict: a warning is an error. In a copy, so that an undocumented name can be planted."""
    for name in ("docs", "icac_jax", "examples"):
        shutil.copytree(ROOT / name, tmp_path / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("mkdocs.yml", "CHANGELOG.md", "CONTRIBUTING.md"):
        shutil.copy(ROOT / name, tmp_path / name)

    def build():
        command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet"]
        return subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=300, check=False)

    (tmp_path / "docs" / "results").mkdir(exist_ok=True)
    (tmp_path / "docs" / "results" / "planted.md").write_text("# A planted report\n")
    done = build()
    assert done.returncode == 0, done.stderr
    site = tmp_path / "site"
    pages = {page.relative_to(site).as_posix(): page.read_text() for page in site.rglob("*.html")}
    assert 'id="icac_jax.curiosity.itm.nearest_two"' in pages["reference/icac_jax.curiosity.itm.html"]
    assert (
        max(len(text) for name, text in pages.items() if name.startswith("reference/")) < 400_000
    )  # no page of all names
    found = {entry["location"] for entry in json.loads((site / "search" / "search_index.json").read_text())["docs"]}
    for package in reference.packages():
        for module in reference.modules(package):
            for name in reference.public_names(module):
                assert f"reference/{module}.html#{module}.{name}" in found, f"the search does not find {module}.{name}"
    assert "with curiosity" in pages["examples.html"]
    assert pages["algorithm.html"].count("<math ") > 60
    for name, text in pages.items():
        assert 'class="arithmatex"' not in text, name
        left = re.search(r"(code|file|modules|settings|default): [\w./]+ (\||--)", text)
        assert left is None, f"{name}: {left and left[0]} was not replaced"
    assert "A planted report" in pages["index.html"]  # in the navigation
    for name, text in pages.items():
        loaded = re.findall(r'<(?:script|img|iframe)[^>]+src="(?:https?:)?//[^"]*"', text)
        loaded += re.findall(r'<link[^>]+rel="(?:stylesheet|preconnect)"[^>]+href="(?:https?:)?//[^"]*"', text)
        assert loaded == [], name

    with (tmp_path / "icac_jax" / "curiosity" / "itm.py").open("a") as file:
        file.write("\n\ndef planted(x: int) -> int:\n    return x\n")
    done = build()
    assert done.returncode != 0
    assert "icac_jax.curiosity.itm.planted" in done.stderr + done.stdout
