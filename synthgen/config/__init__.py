"""Configuration: the schema, presets and their loading."""

from synthgen.config.load import (
    config_from_dict,
    config_hash,
    load_config,
    resolved_yaml,
)
from synthgen.config.presets import data_folder, list_presets
from synthgen.config.schema import Config

__all__ = [
    "Config",
    "config_from_dict",
    "config_hash",
    "data_folder",
    "list_presets",
    "load_config",
    "resolved_yaml",
]
