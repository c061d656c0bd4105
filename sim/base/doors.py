"""The front door of a package: the names that others may use, each imported when it is first asked for."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable
from typing import Any


def door(package: str, **modules: str) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """`__getattr__` and `__dir__` of `package`. modules: names to re-export, parted by blanks, by the module they are in;
    `a:b` is called b here.

    To import all of them at once would make every start as slow as the slowest of them.
    """
    parts = [
        (f"{package}.{module}", *name.partition(":")[::2])
        for module, names in modules.items()
        for name in names.split()
    ]
    homes = {shown or name: (module, name) for module, name, shown in parts}

    def get(name: str) -> Any:
        if name not in homes:
            raise AttributeError(f"{package} has no {name!r}; it has {', '.join(homes)}")
        module, own = homes[name]
        value = getattr(importlib.import_module(module), own)
        setattr(sys.modules[package], name, value)
        return value

    return get, lambda: sorted({*vars(sys.modules[package]), *homes})
