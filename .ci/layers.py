"""Print the rooms of the house, floor by floor, and the imports between them; 1 if any import leads round in a circle.

Usage: python .ci/layers.py

A room is a folder with modules: `sim/earth`, `calib/linear`, `gap`. It stands one floor above the highest that it imports.
"""

from __future__ import annotations

import ast
import sys
from collections import defaultdict
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
FOLDERS = {
    "sim": "fluxtwin.sim",
    "calib": "fluxtwin.calib",
    "gap": "fluxtwin.gap",
    "plots": "fluxtwin.plots",
    "scenarios": "fluxtwin.scenarios",
    "api": "fluxtwin",
}
MOST_FLOORS = {"sim": 7, "calib": 5, "gap": 8}
"""Floors that a wing may have, counted within the wing."""
Graph = dict[str, set[str]]


def sources() -> dict[str, Path]:
    """Every module of the product by its import name; scripts that build data are no modules."""
    found = {}
    for folder, package in FOLDERS.items():
        for path in sorted((ROOT / folder).rglob("*.py")):
            parts = path.relative_to(ROOT / folder).with_suffix("").parts
            if not parts[-1].startswith("build_"):
                found[".".join((package, *(p for p in parts if p != "__init__")))] = path
    return found


def imports_of(source: str, known: set[str]) -> set[str]:
    """Every module a source imports, at its top, inside functions or for type checking."""
    found = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "relative import"
            names = {f"{node.module}.{alias.name}" for alias in node.names}
            found |= names & known or {str(node.module)}
    return found


def room_of(module: str, known: dict[str, Path]) -> str:
    """`sim.earth` for fluxtwin.sim.earth.frames, `sim.spacecraft` for its sensors too, `gap` for fluxtwin.gap.diagnose."""
    parts = module.split(".")[1:]
    if not parts or parts[0] not in FOLDERS or parts[0] == "api":
        return "api"
    inner = parts[0] in ("sim", "calib", "gap") and len(parts) > 1
    package = inner and (len(parts) > 2 or known[module].name == "__init__.py")
    return ".".join(parts[:2]) if package else parts[0]


def rooms(known: dict[str, Path]) -> tuple[Graph, dict[tuple[str, str], int]]:
    """Which room imports which, and by how many imports."""
    graph: Graph = defaultdict(set)
    arrows: dict[tuple[str, str], int] = defaultdict(int)
    for module, path in known.items():
        here = room_of(module, known)
        graph[here]  # a room without imports is a room
        for name in imports_of(path.read_text(encoding="utf-8"), set(known)) & set(known):
            there = room_of(name, known)
            if there != here:
                graph[here].add(there)
                arrows[here, there] += 1
    return dict(graph), dict(arrows)


def circle(graph: Graph) -> list[str]:
    """The rooms of a circle of imports; empty if there is none."""
    done: set[str] = set()

    def follow(room: str, way: list[str]) -> list[str]:
        if room in way:
            return [*way[way.index(room) :], room]
        if room not in done:
            for target in sorted(graph.get(room, ())):
                if found := follow(target, [*way, room]):
                    return found
            done.add(room)
        return []

    for room in sorted(graph):
        if found := follow(room, []):
            return found
    return []


def floors(graph: Graph) -> dict[str, int]:
    """The floor of each room of a graph without circles; those that import nothing stand on floor 1."""
    floor: dict[str, int] = {}

    def stand(room: str) -> int:
        if room not in floor:
            floor[room] = 1 + max((stand(target) for target in graph[room]), default=0)
        return floor[room]

    for room in graph:
        stand(room)
    return floor


def within(graph: Graph, wing: str) -> Graph:
    """The rooms of one wing, and the imports among them."""
    inside = {room for room in graph if room == wing or room.startswith(f"{wing}.")}
    return {room: graph[room] & inside for room in inside}


def main() -> int:
    """Print; 1 where there is a circle or a wing has too many floors."""
    known = sources()
    graph, arrows = rooms(known)
    if found := circle(graph):
        print("imports lead round in a circle:", " -> ".join(found))
        return 1
    floor = floors(graph)
    lines, files = defaultdict(int), defaultdict(int)
    for module, path in known.items():
        room = room_of(module, known)
        lines[room] += len(path.read_text(encoding="utf-8").splitlines())
        files[room] += 1
    for room in sorted(graph, key=lambda name: (-floor[name], name)):
        below = ", ".join(f"{there} {arrows[room, there]}" for there in sorted(graph[room]))
        print(f"{floor[room]:2d}  {room:16s}{files[room]:4d} files{lines[room]:7d} lines   {below}")
    high = False
    for wing, most in MOST_FLOORS.items():
        inside = within(graph, wing)
        height = max(floors(inside).values())
        count = sum(len(targets) for targets in inside.values())
        print(f"{wing}: {len(inside)} rooms on {height} floors, {count} arrows, {sum(lines[r] for r in inside)} lines")
        high |= height > most
    print(f"the house: {len(graph)} rooms on {max(floor.values())} floors, {len(arrows)} arrows, no circle")
    print(f"{sum(files.values())} files, {sum(lines.values())} lines")
    if high:
        print("too many floors:", ", ".join(f"{wing} may have {most}" for wing, most in MOST_FLOORS.items()))
    return int(high)


if __name__ == "__main__":
    sys.exit(main())
