"""Writes the tables of options from their declarations, so that no default stands in two places.

`<!-- settings: CaclaSpec -->` becomes the table of one record, `<!-- default: sigma -->` the default of one option;
`<!-- default: sigma nico4 paper-literal -->` is that of one arm and preset. In a table "Default" is what the
declaration says, so what the record gives in Python; columns of their own say what the presets of the arms make of it.
"""

import dataclasses
import math
import re
import typing
from typing import Any

from icac_jax.agents import curious_ddpg, td3
from icac_jax.agents.cacla import CaclaHyper, CaclaSpec
from icac_jax.agents.ddpg_options import DdpgHyper, DdpgSpec
from icac_jax.agents.imitation import ImitationOptions
from icac_jax.curiosity import CuriosityHyper, CuriositySpec
from icac_jax.envs.goals import GoalOptions
from icac_jax.envs.reach import ReachParams
from icac_jax.fields import allowed
from icac_jax.settings import presets
from icac_jax.settings.options import all_options, defaults, owners
from icac_jax.settings.run_options import CameraOptions, RunOptions, WarmOptions

_OF_THE_PAPER = {
    record.__name__: record
    for record in (
        RunOptions,
        WarmOptions,
        CameraOptions,
        ReachParams,
        GoalOptions,
        ImitationOptions,
        CaclaSpec,
        CaclaHyper,
        CuriositySpec,
        CuriosityHyper,
    )
}
# Learners beyond the paper; the preset `best` is of TD3.
_BEYOND = {
    "DdpgSpec": DdpgSpec,
    "DdpgHyper": DdpgHyper,
    "Td3Hyper": td3.Hyper,
    "CuriousSpec": curious_ddpg.Spec,
    "CuriousHyper": curious_ddpg.Td3Hyper,
}
# What a table leaves out because it stands in another one.
_ELSEWHERE = {
    "Td3Hyper": [DdpgHyper],
    "CuriousSpec": [DdpgSpec, CuriositySpec],
    "CuriousHyper": [td3.Hyper, CuriosityHyper],
}
RECORDS = _OF_THE_PAPER | _BEYOND
_TABLE = re.compile(r"^<!-- settings: (\w+) -->$", re.M)
_DEFAULT = re.compile(rf"<!-- default: (\w+)(?: ({'|'.join(presets.PRESETS)}))?(?: (paper-literal))? -->")
_UNSTATED = ("own", "open point")
_CHOOSE_DEFAULTS = ("arm", "preset")  # all other defaults depend on these


def shown(value: Any) -> str:
    """A value as one types it."""
    if isinstance(value, tuple):
        return " ".join(map(shown, value))
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        return "inf" if math.isinf(value) else f"{value:.4g}"
    return str(value)


def values(name: str, preset: str) -> dict[str, str]:
    """The value of an option for each arm that has presets."""
    algo = (owners(name) or ["icac"])[0]
    return {arm: shown(defaults(arm, preset, algo)[name]) for arm in presets.PRESETS}


def default(name: str, preset: str = "paper", only: str | None = None) -> str:
    """What an option is in a run that does not say: one value, or one an arm where they differ.

    Args:
      name: of the option.
      preset: whose default.
      only: the arm if only one is asked for.
    """
    if name in _CHOOSE_DEFAULTS:
        return f"`{all_options()[name].default}`"
    by_arm = values(name, preset)
    if only is not None:
        return f"`{by_arm[only]}`"
    if len(set(by_arm.values())) == 1:
        return f"`{next(iter(by_arm.values()))}`"
    return ", ".join(f"`{value}` ({arm})" for arm, value in by_arm.items())


def declared(field: dataclasses.Field) -> str:
    """The default that the declaration states, in words; a dash where it is nothing."""
    value = shown(field.default)
    return f"`{value}`" if value else "–"


def changed(field: dataclasses.Field) -> str:
    """What the preset `paper` makes of a declared default, an arm at a time; a dash where it leaves it."""
    if field.name in _CHOOSE_DEFAULTS:
        return "–"
    by_arm = values(field.name, "paper")
    other = {arm: value for arm, value in by_arm.items() if value != shown(field.default)}
    return ", ".join(f"`{value}` ({arm})" for arm, value in other.items()) or "–"


def paper(field: dataclasses.Field) -> str:
    """The paper's value, read to the letter; "not stated" where it is silent, a dash where it could not say it."""
    if field.name in _CHOOSE_DEFAULTS or field.metadata["source"].startswith(_UNSTATED):
        return "not stated" if field.metadata["source"] == "open point" else "–"
    return default(field.name, "paper-literal")


def best(field: dataclasses.Field) -> str:
    """What the preset `best` makes of a default of TD3, an arm at a time; a dash where it leaves it."""
    by_arm = {arm: defaults(arm, "best", "td3").get(field.name, field.default) for arm in presets.PRESETS}
    other = {arm: shown(value) for arm, value in by_arm.items() if value != field.default}
    if len(other) == len(by_arm) and len(set(other.values())) == 1:
        return f"`{other.popitem()[1]}`"
    return ", ".join(f"`{value}` ({arm})" for arm, value in other.items()) or "–"


def fields_of(name: str) -> list[dataclasses.Field]:
    """The options of a record that its table has."""
    elsewhere = {field.name for record in _ELSEWHERE.get(name, []) for field in dataclasses.fields(record)}
    return [
        field
        for field in dataclasses.fields(RECORDS[name])
        if not field.metadata.get("derived") and field.name not in elsewhere
    ]


def table(name: str) -> str:
    """The Markdown table of one record of settings."""
    middle = (
        "Preset `paper` | Paper, to the letter" if name in _OF_THE_PAPER else "Preset `best` | Paper, to the letter"
    )
    lines = [
        f"| Option | What it is | Unit | Default | {middle} | Allowed | Source |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for field in fields_of(name):
        choices = typing.get_args(field.type) if typing.get_origin(field.type) is typing.Literal else ()
        limits = ", ".join(f"`{choice}`" for choice in choices) or allowed(field)
        limits = "these names" if field.name in _CHOOSE_DEFAULTS else limits
        option = "--" + field.name.replace("_", "-")
        cells = [f"`{option}`", field.metadata["help"], field.metadata["unit"] or "–"]
        read = (changed(field), paper(field)) if name in _OF_THE_PAPER else (best(field), "–")
        cells += [declared(field), *read, limits, field.metadata["source"]]
        lines.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    return "\n".join(lines)


def on_page_markdown(markdown: str, **_: Any) -> str:
    """What mkdocs calls for every page."""
    markdown = _TABLE.sub(lambda match: table(match[1]), markdown)
    return _DEFAULT.sub(lambda match: default(match[1], match[3] or "paper", match[2]), markdown)
