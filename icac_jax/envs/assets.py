"""Where the model files are: inside the installed package, beside it in a source checkout, or where a path says."""

from pathlib import Path

from icac_jax.fields import ConfigError

_PACKAGE = Path(__file__).resolve().parents[1]


def path(name: str) -> Path:
    """The file `name` of the assets; a whole path is that file.

    Raises:
      ConfigError: the path leads to no file.
      FileNotFoundError: the installation lacks it.
    """
    if Path(name).is_absolute():
        if not Path(name).is_file():
            raise ConfigError(f"model: there is no file {name}")
        return Path(name)
    for folder in (_PACKAGE / "assets", _PACKAGE.parent / "assets"):
        if (folder / name).is_file():
            return folder / name
    raise FileNotFoundError(f"asset {name} is missing from this installation of icac_jax")
