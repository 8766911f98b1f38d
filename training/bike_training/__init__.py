"""Training, evaluation and the `bike` command."""

import importlib.util
import sys
from collections.abc import Sequence
from importlib.machinery import ModuleSpec
from types import ModuleType


class _Registration:
    """Finder of Gymnasium that registers this project's environments after it.

    Gymnasium 1 looks for no plug-ins. To import it here would double the time of `bike --help`, and riding needs none.
    """

    @classmethod
    def find_spec(cls, name: str, path: Sequence[str] | None, target: ModuleType | None = None) -> ModuleSpec | None:
        """Return the specification of Gymnasium, whose loader registers; None for other modules."""
        if name != "gymnasium":
            return None
        sys.meta_path.remove(cls)
        spec = importlib.util.find_spec(name)
        if spec is not None and spec.loader is not None:
            load = spec.loader.exec_module

            def load_and_register(module: ModuleType) -> None:
                load(module)
                importlib.import_module("bike_training.gymnasium_ids")

            spec.loader.exec_module = load_and_register  # type: ignore[method-assign]
        return spec


if "gymnasium" in sys.modules:
    importlib.import_module("bike_training.gymnasium_ids")
else:
    sys.meta_path.insert(0, _Registration)
