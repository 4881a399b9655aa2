"""Writes the API reference from the modules that there are, and ends the build on a public name without documentation.

Each module has a page of its own. In the navigation it stands below the page that has its package's directive:
`<!-- modules: icac_jax.envs -->` becomes a table of that package's modules, sub-packages left out, what each is for and
its public names. `<!-- names: icac_jax -->` becomes a table of what a package hands on from its modules.
"""

import ast
import importlib
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File

_ROOT = Path(__file__).resolve().parents[2]
_MODULES = re.compile(r"^<!-- modules: ([\w.]+) -->$", re.M)
_NAMES = re.compile(r"^<!-- names: ([\w.]+) -->$", re.M)
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


@cache
def _tree(module: str) -> ast.Module:
    path = _ROOT / module.replace(".", "/")
    return ast.parse((path / "__init__.py" if path.is_dir() else path.with_suffix(".py")).read_text())


def public_names(module: str) -> list[str]:
    """Public functions and classes of a module, in the order of its text."""
    named = [item for item in _tree(module).body if isinstance(item, ast.FunctionDef | ast.ClassDef)]
    return [item.name for item in named if not item.name.startswith("_")]


def page(module: str) -> str:
    """Path of a module's page below docs/."""
    return f"reference/{module}.md"


def pages() -> dict[str, str]:
    """The pages that are no files: path and Markdown, for each module one."""
    each = (module for package in packages() for module in modules(package))
    return {page(module): f"::: {module}\n    options:\n      heading_level: 1\n" for module in each}


def _purpose(module: str) -> str:
    text = (ast.get_docstring(_tree(module)) or "").partition("\n\n")[0]
    return (
        re.split(r"(?<!Eq\.)(?<!Sec\.)(?<!al\.)(?<=[.:;]) ", " ".join(text.split()))[0]
        .rstrip(":.;")
        .replace("|", r"\|")
    )


def of_package(package: str) -> str:
    """The table of a package's modules. Its rows have the anchors that names had when all were on one page."""
    rows = ["| Module | What it is for | Public names |", "|---|---|---|"]
    for module in modules(package):
        full = {name: f"{module}.{name}" for name in public_names(module)}
        anchors = "".join(f'<a id="{name}"></a>' for name in (module, *full.values()))
        links = ", ".join(f"[`{name}`][{path}]" for name, path in full.items())
        rows.append(f"| {anchors}[`{module.rpartition('.')[2]}`]({module}.md) | {_purpose(module)} | {links} |")
    return "\n".join(rows)


def handed_on(package: str) -> str:
    """The table of the names that a package hands on, each with the module that describes it."""
    module = importlib.import_module(package)
    rows = ["| Name | Where it is described |", "|---|---|"]
    for name in sorted(module.__all__):
        value = getattr(module, name)
        path = f"{value.__module__}.{value.__qualname__}" if hasattr(value, "__qualname__") else value.__name__
        rows.append(f"| `{package}.{name}` | [`{path}`][{path}] |")
    return "\n".join(rows)


def _with_modules(entry: Any, docs: Path) -> Any:
    """An entry of the navigation; where its page has tables of modules, these stand below it."""
    if isinstance(entry, list):
        return [_with_modules(one, docs) for one in entry]
    if isinstance(entry, str):
        return entry
    ((title, target),) = entry.items()
    if isinstance(target, list):
        return {title: _with_modules(target, docs)}
    found = [module for package in _MODULES.findall((docs / target).read_text()) for module in modules(package)]
    below = [{module.partition(".")[2].rpartition(".")[2] or module: page(module)} for module in found]
    return {title: [target, *below]} if below else entry


def on_config(config: Any) -> Any:
    """What mkdocs calls first."""
    missing = all_undocumented()
    if missing:
        raise PluginError(f"without documentation: {', '.join(missing)}")
    config["nav"] = _with_modules(config["nav"], Path(config["docs_dir"]))
    return config


def on_files(files: Any, *, config: Any) -> Any:
    """What mkdocs calls when it knows which files there are."""
    for path, text in pages().items():
        files.append(File.generated(config, path, content=text))
    return files


def on_page_markdown(markdown: str, **_: Any) -> str:
    """What mkdocs calls for every page."""
    markdown = _MODULES.sub(lambda match: of_package(match[1]), markdown)
    return _NAMES.sub(lambda match: handed_on(match[1]), markdown)
