"""Writes the API reference from the modules that there are, and ends the build on a public name without documentation.

`<!-- modules: icac_jax.envs -->` becomes one section a module of that package, its sub-packages left out.
"""

import ast
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from mkdocs.exceptions import PluginError

_ROOT = Path(__file__).resolve().parents[2]
_DIRECTIVE = re.compile(r"^<!-- modules: ([\w.]+) -->$", re.M)
# A field made by one of these carries its own help text.
_DECLARED = ("param", "flag", "no_cache", "checkpoint_every")


def modules(package: str) -> list[str]:
    """Full names of a package's modules, sub-packages left out, the package itself not counted."""
    folder = _ROOT / package.replace(".", "/")
    return [f"{package}.{path.stem}" for path in sorted(folder.glob("*.py")) if not path.stem.startswith("__")]


def packages() -> list[str]:
    """Full names of all packages, the outermost first."""
    folders = sorted(path.parent.relative_to(_ROOT) for path in (_ROOT / "icac_jax").rglob("__init__.py"))
    return [".".join(folder.parts) for folder in folders]


def _fields(node: ast.ClassDef) -> Iterator[str]:
    """Public fields of a record that neither its docstring nor their own declaration describes."""
    text = ast.get_docstring(node) or ""
    for item in node.body:
        if isinstance(item, ast.AnnAssign) and isinstance(item.target, ast.Name):
            declared = isinstance(item.value, ast.Call) and ast.unparse(item.value.func).split(".")[-1] in _DECLARED
            name = item.target.id
            of_class = ast.unparse(item.annotation).split("[")[0].endswith("ClassVar")
            if not (name.startswith("_") or declared or of_class or re.search(rf"^\s+{name}: ", text, re.M)):
                yield name


def undocumented(source: str, module: str) -> list[str]:
    """Public names of a module, and fields of its public classes, that nothing documents.

    Args:
      source: the module's text.
      module: its name, for the answer.
    """
    missing = []

    def visit(node: Any, name: str) -> None:
        if not ast.get_docstring(node):
            missing.append(name)
        if isinstance(node, ast.ClassDef):
            missing.extend(f"{name}.{field}" for field in _fields(node))
        if isinstance(node, ast.Module | ast.ClassDef):
            for item in node.body:
                is_public = isinstance(item, ast.FunctionDef | ast.ClassDef) and not item.name.startswith("_")
                if is_public:
                    visit(item, f"{name}.{item.name}")

    visit(ast.parse(source), module)
    return missing


def all_undocumented() -> list[str]:
    """What is undocumented in the whole package."""
    missing = []
    for package in packages():
        files = [_ROOT / f"{name.replace('.', '/')}.py" for name in (f"{package}.__init__", *modules(package))]
        for path in files:
            missing += undocumented(path.read_text(), ".".join(path.relative_to(_ROOT).with_suffix("").parts))
    return missing


def on_config(config: Any) -> Any:
    """What mkdocs calls first."""
    missing = all_undocumented()
    if missing:
        raise PluginError(f"without documentation: {', '.join(missing)}")
    return config


def on_page_markdown(markdown: str, **_: Any) -> str:
    """What mkdocs calls for every page."""
    return _DIRECTIVE.sub(lambda match: "\n\n".join(f"::: {name}" for name in modules(match[1])), markdown)
