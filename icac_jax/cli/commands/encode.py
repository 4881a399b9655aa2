"""`icac encode`: an encoder of the pictures of an arm, with which `icac train --encoder` sees instead of its joints."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path

from icac_jax import console
from icac_jax.cli.commands import common
from icac_jax.envs.embedding import PARTS, EncoderOptions


@dataclasses.dataclass(frozen=True)
class EncodeOptions(EncoderOptions):
    """What `icac encode` takes."""

    arm: str = common.flag("planar2", "planar2, nico4, or a file or folder of an own arm")
    tip: str = common.flag("", "site or body that reaches, of an arm that is a model file")
    out: Path | None = common.flag(None, "file; ARM-encoder.npz if not given; a figure beside it")
    no_cache: bool = common.no_cache()


def main(args: Sequence[str]) -> int:
    """Reads the arguments, does it, returns the exit status."""
    given = common.options("encode", EncodeOptions, args)
    if given is None:
        return 0
    common.prepare(given.no_cache)
    from icac_jax.analysis import encoder_figure
    from icac_jax.runs import encoders
    from icac_jax.settings import arm_files

    arm = arm_files.find(given.arm, given.tip).arm
    out = given.out or Path(f"{arm.name}-encoder.npz")
    chosen = {field.name: getattr(given, field.name) for field in dataclasses.fields(EncoderOptions)}
    embedding = encoders.encode(given.arm, out, tip=given.tip, progress=True, **chosen)
    picture = out.with_suffix(".png")
    encoder_figure.write(picture, arm, embedding)
    print(f"{arm.name}, {given.method}: {embedding.size} entries per picture, {embedding.facts['seconds']:.0f} s")
    for part in PARTS:
        facts = embedding.facts[part]
        error = "" if facts["error"] is None else f"error {facts['error']:.1%} of the pictures' variance, "
        print(f"{part:5} {error}R^2 of a linear read-out {', '.join(f'{one:.3f}' for one in facts['read_out'])}")
    print(f"written to {console.shown(out)} and {console.shown(picture)}")
    return 0
