"""Scripts with which shells complete commands, options and their values, from the declarations of the options."""

import dataclasses
import importlib
import shlex
import typing
from collections.abc import Callable
from typing import Any, NamedTuple

from icac_jax.agents import registry
from icac_jax.envs.arms import ARMS
from icac_jax.settings import options as settings

# Commands whose first argument is no folder or file.
_WORDS = {"completion": ("bash", "zsh", "fish")}


class Option(NamedTuple):
    """An option of a command.

    Attributes:
      name: with its dashes.
      help: a line.
      values: what it can be given; empty where that is anything, such as a number or a file.
      flag: whether it takes no value.
    """

    name: str
    help: str
    values: tuple[str, ...]
    flag: bool


def _choices(kind: Any) -> tuple[str, ...]:
    """The values that a type allows, where it lists them."""
    parts = typing.get_args(kind)
    if typing.get_origin(kind) is typing.Literal:
        return tuple(map(str, parts))
    return tuple(choice for part in parts for choice in _choices(part))


def _of_record(record: type) -> list[Option]:
    kinds, marked = typing.get_type_hints(record), typing.get_type_hints(record, include_extras=True)
    found = []
    for field in dataclasses.fields(record):
        if field.metadata.get("hidden"):
            continue
        flag = kinds[field.name] is bool
        if "positional" not in getattr(marked[field.name], "__metadata__", ()):
            dashed, help = field.name.replace("_", "-"), field.metadata["help"]
            found.append(Option(f"--{dashed}", help, _choices(kinds[field.name]), flag))
            if flag and field.default is True:
                found[-1] = found[-1]._replace(name=f"--no-{dashed}")
    return found


def _of_settings() -> list[Option]:
    known = {"algo": tuple(registry.learners()), "arm": tuple(ARMS)}
    found = []
    for name, field in settings.all_options().items():
        values = known.get(name) or (("true", "false") if field.type is bool else _choices(field.type))
        found.append(Option(f"--{name.replace('_', '-')}", field.metadata["help"], values, False))
    return found


def options(command: str) -> list[Option]:
    """The options of a command.

    Args:
      command: its name.
    """
    module = importlib.import_module(f"icac_jax.cli.commands.{command.replace('-', '_')}")
    records = [
        kind
        for kind in vars(module).values()
        if isinstance(kind, type) and dataclasses.is_dataclass(kind) and kind.__module__ == module.__name__
    ]
    found = [option for record in records for option in _of_record(record)]
    return found + (_of_settings() if command == "train" else [])


def _bash(commands: dict[str, str]) -> str:
    cases, values = [], []
    for command in commands:
        mine = options(command)
        words = " ".join([*(option.name for option in mine), *_WORDS.get(command, ())])
        cases.append(f"    {command}) words={shlex.quote(words)} ;;")
        for option in mine:
            if option.values:
                values.append(f'    "{command} {option.name}") words={shlex.quote(" ".join(option.values))} ;;')
    named = shlex.quote(" ".join([*commands, "help"]))
    body = [
        '# Completion of icac for bash: eval "$(icac completion bash)"',
        "_icac() {",
        '  local current="${COMP_WORDS[COMP_CWORD]}" before="${COMP_WORDS[COMP_CWORD-1]}" words=""',
        "  if [[ $COMP_CWORD -eq 1 || ( $COMP_CWORD -eq 2 && $before == help ) ]]; then",
        f'    COMPREPLY=($(compgen -W {named} -- "$current"))',
        "    return",
        "  fi",
        '  case "${COMP_WORDS[1]} $before" in',
        *values,
        "  esac",
        "  if [[ -z $words && ( $current == -* || ${COMP_WORDS[1]} == completion ) ]]; then",
        '    case "${COMP_WORDS[1]}" in',
        *(f"  {case}" for case in cases),
        "    esac",
        "  fi",
        '  if [[ -n $words ]]; then COMPREPLY=($(compgen -W "$words" -- "$current"))',
        '  else COMPREPLY=($(compgen -f -- "$current")); fi',
        "}",
        "complete -o filenames -F _icac icac",
    ]
    return "\n".join(body)


def _zsh(commands: dict[str, str]) -> str:
    described = " ".join(
        shlex.quote(f"{name}:{help}") for name, help in (commands | {"help": "options of a command"}).items()
    )
    cases, values = [], []
    for command in commands:
        mine = options(command)
        pairs = " ".join(shlex.quote(f"{option.name}:{option.help}") for option in mine)
        cases.append(f"    {command}) options=({pairs}); words_of=({' '.join(_WORDS.get(command, ()))}) ;;")
        values += [
            f"    '{command} {option.name}') compadd -- {' '.join(map(shlex.quote, option.values))}; return ;;"
            for option in mine
            if option.values
        ]
    body = [
        "#compdef icac",
        '# Completion of icac for zsh: eval "$(icac completion zsh)", after compinit',
        "_icac() {",
        "  local -a commands options words_of",
        f"  commands=({described})",
        "  if (( CURRENT == 2 )) || [[ CURRENT -eq 3 && $words[2] == help ]]; then",
        "    _describe command commands; return",
        "  fi",
        '  case "$words[2] $words[CURRENT-1]" in',
        *values,
        "  esac",
        '  case "$words[2]" in',
        *cases,
        "  esac",
        "  if (( $#words_of )); then compadd -- $words_of",
        "  elif [[ $words[CURRENT] == -* ]]; then _describe option options",
        "  else _files; fi",
        "}",
        "compdef _icac icac",
    ]
    return "\n".join(body)


def _fish(commands: dict[str, str]) -> str:
    lines = ["# Completion of icac for fish: icac completion fish > ~/.config/fish/completions/icac.fish"]
    for name, help in (commands | {"help": "options of a command"}).items():
        lines.append(f"complete -c icac -n __fish_use_subcommand -f -a {name} -d {shlex.quote(help)}")
    lines.append(f"complete -c icac -n '__fish_seen_subcommand_from help' -f -a {shlex.quote(' '.join(commands))}")
    for command in commands:
        seen = f"-n '__fish_seen_subcommand_from {command}'"
        for word in _WORDS.get(command, ()):
            lines.append(f"complete -c icac {seen} -f -a {word}")
        for option in options(command):
            takes = "" if option.flag else f" -x -a {shlex.quote(' '.join(option.values))}" if option.values else " -r"
            lines.append(f"complete -c icac {seen} -l {option.name[2:]}{takes} -d {shlex.quote(option.help)}")
    return "\n".join(lines)


SHELLS: dict[str, Callable[[dict[str, str]], str]] = {"bash": _bash, "zsh": _zsh, "fish": _fish}


def script(shell: str, commands: dict[str, str]) -> str:
    """The script for a shell.

    Args:
      shell: a key of `SHELLS`.
      commands: the commands with a line on each.
    """
    return SHELLS[shell](commands)
