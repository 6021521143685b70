"""Puts plain ES modules of `web/` together into one script, so that a page opens without a server.

A page of another package is put together of its own `web/` and of this one (`places`).

Browsers refuse to import modules from files on disk. So each module becomes a function that returns what
it exports, called in order. The modules keep to two forms, which stand alone on their lines and are checked:

    import { a, b } from "./other.js";
    export function f(...) {    export const c = ...    export class D {

`three` is the exception: `import * as THREE from "three";`, a script of its own that sets the global name.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from importlib.resources import files

_IMPORT = re.compile(r'^import \{ (\w+(?:, \w+)*) \} from "\./([\w-]+\.js)";$', re.MULTILINE)
_THREE = re.compile(r'^import \* as THREE from "three";$', re.MULTILINE)
_EXPORT = re.compile(r"^export (async function|function|const|class) (\w+)", re.MULTILINE)
_LEFT = re.compile(r"^\s*(?:import\b|export\b).*$", re.MULTILINE)


OWN = ("baselines.replay",)


def text_of(name: str, places: Sequence[str] = OWN) -> str:
    """A file of the `web/` of the first of some packages that has it. Raises `FileNotFoundError`."""
    for place in places:
        file = files(place).joinpath("web", *name.split("/"))
        if file.is_file():
            return file.read_text(encoding="utf-8")
    raise FileNotFoundError(f"{name}: not in web/ of {', '.join(places)}")


def linked(main: str, places: Sequence[str] = OWN) -> str:
    """The script that runs the module `main` and all that it imports.

    Raises `ValueError` naming a module with an import or export of another form.
    """
    order: list[str] = []
    _visit(main, order, (), places)
    parts = [_wrapped(name, places) for name in order]
    return '(() => {\n"use strict";\nconst modules = {};\n' + "\n".join(parts) + "\n})();\n"


def _visit(name: str, order: list[str], above: tuple[str, ...], places: Sequence[str]) -> None:
    """The modules that one needs, and then itself; `above` are those that need it."""
    if name in above:
        raise ValueError(f"{name}: imports itself by way of {', '.join(above)}")
    for _, other in _IMPORT.findall(text_of(name, places)):
        if other not in order:
            _visit(other, order, (*above, name), places)
    if name not in order:
        order.append(name)


def _wrapped(name: str, places: Sequence[str]) -> str:
    source = text_of(name, places)
    exported = [found for _, found in _EXPORT.findall(source)]
    source = _IMPORT.sub(r'const { \1 } = modules["\2"];', _THREE.sub("", source))
    source = _EXPORT.sub(r"\1 \2", source)
    left = _LEFT.search(source)
    if left is not None:
        raise ValueError(
            f"{name}: {left[0].strip()!r}: expected the forms of baselines.replay.linking"
        )
    returned = ", ".join(exported)
    return f'modules["{name}"] = (() => {{\n{source}\nreturn {{ {returned} }};\n}})();'
