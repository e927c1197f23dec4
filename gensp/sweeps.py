"""What a sweep varies names the folders, so that its jobs do not meet in one.

Hydra tells a job all words that were typed for it, not which of them are swept: `train.py -m` adds
them as `swept=[...]`, which any launcher hands on.
"""

import re
from collections.abc import Sequence

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import OverrideParseException
from omegaconf import DictConfig, OmegaConf

from gensp.errors import Unsupported

# The stages, each after those that it reads.
ORDER = (
    *("augment", "implicit", "correspond", "initialize", "finetune"),
    *("parameterize", "evaluate"),
)
# The first stage that a key changes; the stages before are shared.
_FIRST = {
    **{f"recipe.{stage}": stage for stage in ORDER},
    "seed": "augment",
    "recipe.cloud": "implicit",
    "recipe.draws": "implicit",
    "recipe.model": "implicit",
    "recipe.model.generator": "initialize",
    "recipe.fit": "parameterize",
    "recipe.refine": "parameterize",
    "recipe.cmcf": "parameterize",
    "recipe.pictures": "evaluate",
}


def with_swept(words: Sequence[str]) -> list[str]:
    """The words of the command line, with those keys named of which -m varies the value."""
    if not {"-m", "--multirun"} & set(words):
        return list(words)
    typed = [word for word in words if "=" in word and not word.startswith("-")]
    try:
        parsed = OverridesParser.create().parse_overrides(typed)
    except OverrideParseException:
        return list(words)  # told by Hydra
    keys = [word.get_key_element().lstrip("+~") for word in parsed if word.is_sweep_override()]
    named = [key for key in keys if _first(key) is not None]
    given = any(word.get_key_element().lstrip("+~") == "swept" for word in parsed)
    return [*words, f"swept=[{','.join(named)}]"] if named and not given else list(words)


def _first(key: str) -> str | None:
    """The first stage that a key changes: that of its longest known beginning."""
    parts = key.split(".")
    beginnings = (".".join(parts[:count]) for count in range(len(parts), 0, -1))
    return next((_FIRST[name] for name in beginnings if name in _FIRST), None)


def suffix(cfg: DictConfig, stage: str) -> str:
    """What a sweep adds to the name of a stage's variant: keys and values up to that stage.

    Raises
    ------
    Unsupported
        A key of `swept` is none that names a folder.
    """
    parts = []
    for key in cfg.get("swept") or ():
        first = _first(str(key))
        if first is None or OmegaConf.select(cfg, key) is None:
            raise Unsupported(
                f"swept: has '{key}'; keys of recipe.* with a value, or seed, are required; "
                "leave it out, and give every value a name=NAME of its own"
            )
        if stage in ORDER and ORDER.index(first) <= ORDER.index(stage):
            parts.append(f"+{str(key).removeprefix('recipe.')}-{_word(cfg, str(key))}")
    return "".join(parts)


def _word(cfg: DictConfig, key: str) -> str:
    """A value as part of a folder's name."""
    value = OmegaConf.select(cfg, key)
    plain = OmegaConf.to_container(value) if OmegaConf.is_config(value) else value
    return re.sub(r"[^\w.,-]+", "_", str(plain)).strip("_")


def named(cfg: DictConfig, variant: str) -> DictConfig:
    """The configuration whose tables and loggers call the variant by what is swept, too.

    Parameters
    ----------
    variant
        The name that the stage's folder belongs to.
    """
    found: DictConfig = cfg.copy()
    # No key of the configuration before: a folder is not named by typing it.
    OmegaConf.update(found, "variant", variant, force_add=True)
    if cfg.get("swept"):
        found.method.variant = cfg.method.variant + suffix(cfg, "evaluate")
    return found


def suffixes(cfg: DictConfig) -> dict[str, str]:
    """The same for all stages; empty without a sweep."""
    return {stage: suffix(cfg, stage) for stage in ORDER} if cfg.get("swept") else {}
