"""A key that is given twice in a YAML mapping is a mistake, of which YAML would silently drop the first."""

from __future__ import annotations

from typing import Any

import yaml


class UniqueKeys(yaml.constructor.BaseConstructor):
    """Makes a YAML loader refuse a key given twice: ``class Loader(UniqueKeys, yaml.SafeLoader)``."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        """Return a mapping.

        Raises:
            yaml.MarkedYAMLError: a key stands there twice.
        """
        seen: set[str] = set()
        for key, _ in node.value:
            if isinstance(key, yaml.ScalarNode):
                if key.value in seen:
                    raise yaml.MarkedYAMLError(problem=f"key {key.value!r} is given twice", problem_mark=key.start_mark)
                seen.add(key.value)
        mapping: dict[Any, Any] = super().construct_mapping(node, deep)
        return mapping
