"""examples/first_steps.ipynb: its cells run in order, with small numbers, and what they show is there."""

import ast
import contextlib
import io
import json
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import pytest
from matplotlib.figure import Figure
from PIL import Image

from icac_jax.trained import Trained

ROOT = Path(__file__).resolve().parents[1]
BOOK = json.loads((ROOT / "examples" / "first_steps.ipynb").read_text())
CODE = {cell["id"]: "".join(cell["source"]) for cell in BOOK["cells"] if cell["cell_type"] == "code"}
FEWER = {"seeds": 2, "episodes": 20}


def run(source, names):
    """Runs a cell as Jupyter does: what it prints, and the value of its last line if that is an expression."""
    body = ast.parse(source).body
    last = body.pop() if isinstance(body[-1], ast.Expr) else None
    with contextlib.redirect_stdout(io.StringIO()) as said:
        exec(compile(ast.Module(body, []), "cell", "exec"), names)
        shown = None if last is None else eval(compile(ast.Expression(last.value), "cell", "eval"), names)
    return said.getvalue(), shown


@pytest.fixture(scope="module")
def shown(tmp_path_factory):
    """By cell, what each printed and showed."""
    names, results = {}, {}
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TMPDIR", str(tmp_path_factory.mktemp("notebook")))
        patch.setattr("tempfile.tempdir", None)  # so that it is looked up anew
        with plt.rc_context({"backend": "agg"}):
            for name, source in CODE.items():
                results[name] = run(source, names)
                if name == "parameters":
                    assert set(FEWER) <= set(names)
                    names |= FEWER
    plt.close("all")
    return results


def test_cells_show_a_table_figures_and_a_frame(shown):
    assert isinstance(shown["train"][1], Trained)
    assert shown["table"][0].splitlines()[0].split()[:2] == ["seed", "success"]
    assert len(shown["table"][0].splitlines()) == 1 + FEWER["seeds"]
    (axes,) = shown["figure"][1].axes
    assert len(axes.lines) == FEWER["seeds"] + 1
    assert axes.lines[-1].get_xdata()[-1] == FEWER["episodes"]
    header, reference, beside = shown["compare"][0].splitlines()[1:4]
    assert header.split()[0] == "run"
    assert (reference.split()[0], beside.split()[0]) == ("cacla", "icac")
    assert "by seed" in beside
    assert isinstance(shown["compare-figure"][1], Figure)
    assert isinstance(shown["film"][1], Image.Image)
    assert min(shown["film"][1].size) > 200


def test_it_is_committed_without_outputs_and_needs_only_what_the_package_needs():
    for cell in BOOK["cells"]:
        assert cell.get("outputs", []) == []
        assert cell.get("execution_count") is None
    assert len({cell["id"] for cell in BOOK["cells"]}) == len(BOOK["cells"])
    assert BOOK["nbformat"] == 4
    trees = [ast.walk(ast.parse(source)) for source in CODE.values()]
    imported = {node.module for tree in trees for node in tree if isinstance(node, ast.ImportFrom)}
    trees = [ast.walk(ast.parse(source)) for source in CODE.values()]
    imported |= {one.name for tree in trees for node in tree if isinstance(node, ast.Import) for one in node.names}
    others = {name.split(".")[0] for name in imported} - set(sys.stdlib_module_names)
    assert others <= {"icac_jax", "matplotlib", "numpy", "PIL"}
