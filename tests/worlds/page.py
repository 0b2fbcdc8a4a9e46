"""The table and the pictures of docs/worlds.md."""

import pathlib
import statistics

from planner import shape_of
from surroundings import around

ROOT = pathlib.Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "worlds.md"
BEGIN, END = "<!-- by tests/worlds/run --page -->\n", "<!-- end -->\n"
COLOURS = {"irsim": "#0060a0", "acker": "#2a8a2a", "pybullet": "#c05000"}
PICTURES = {"irsim": ["irsim", "acker"], "pybullet": ["pybullet"]}  # of a simulator: its robots
COLUMNS = ["world", "errors", "drives", "passable", "at the goal", "to the goal: median, largest", "elsewhere"]
COLUMNS += ["stopped", "contacts"]


def kind_of(row):
    """The kind of world of a drive, and its errors."""
    around_it = {"open": "in the open", "rooms": "walls", "pillars": "walls", "niches": "walls"}
    return around_it.get(row["around"], row["world"]), f"`{row['errors']}`"


def table(rows):
    """A row for each kind of world and errors. The simulator says where the robot is, and whether it touched."""
    text = "|" + "|".join(COLUMNS) + "|\n|---|---" + "|---:" * (len(COLUMNS) - 2) + "|\n"
    for kind in dict.fromkeys(map(kind_of, rows)):
        of = [row for row in rows if kind_of(row) == kind]
        passable = [row for row in of if row["passable"]]
        there = [row for row in passable if row.get("there")]
        elsewhere = [row for row in passable if row["outcome"] == "reached" and row not in there]
        stopped = [row for row in of if row["outcome"] == "stopped" and row not in there]
        ends = [row["distance_m"] for row in there + elsewhere]
        far = f"{statistics.median(ends):.2f}, {max(ends):.2f} m" if ends else ""
        share = f"{len(there)}: {100 * len(there) / len(passable):.0f} %" if passable else ""
        touched = sum(bool(row.get("touched")) for row in of)
        cells = [*kind, len(of), len(passable), share, far, len(elsewhere), len(stopped), touched]
        text += "|" + "|".join(map(str, cells)) + "|\n"
    return text


def write(rows, worlds):
    """Writes table and pictures of docs/worlds.md."""
    text = PAGE.read_text(encoding="utf-8")
    before, rest = text.split(BEGIN)
    _, after = rest.split(END)
    PAGE.write_text(before + BEGIN + table(rows) + END + after, encoding="utf-8")
    for simulator, robots in PICTURES.items():
        world = next(world for world in worlds if world["name"] == "slalom")
        shown = [row for row in rows if row["world"] == "slalom" and row["simulator"] in robots and row["seed"] == 1]
        (PAGE.parent / f"worlds-{simulator}.svg").write_text(picture(world, shown), encoding="utf-8")


def picture(world, rows):
    """The ways of drives in a world, as the simulators saw them."""
    (goal_x, goal_y), bodies = world["goal"], world["bodies"] + around(world)
    shapes = [(body, shape_of(body).simplify(0.01)) for body in bodies]
    xs, ys = zip(*[place for _, shape in shapes for place in shape.exterior.coords] or [(-1, -2), (goal_x + 4, 2)])
    left, low, width, height = min(xs), min(ys), max(xs) - min(xs), max(ys) - min(ys)
    parts = [f'<rect x="{left:.2f}" y="{-low - height:.2f}" width="{width:.2f}" height="{height:.2f}" fill="#fff"/>']
    for body, shape in shapes:
        if "velocity" in body:
            (x, y), (vx, vy) = body["at"], body["velocity"]
            line = points([(x, y), (x + 12 * vx, y + 12 * vy)])
            parts.append(f'<polyline points="{line}" fill="none" stroke="#999" stroke-width="0.04"/>')
        parts.append(f'<polygon points="{points(shape.exterior.coords)}" fill="{"#999" if "velocity" in body else "#444"}"/>')
    for row in rows:
        dash = "" if row["errors"] == "none" else ' stroke-dasharray="0.15 0.1"'
        line = f'points="{points(row.get("way", [])[::2])}" fill="none" stroke="{COLOURS[row["simulator"]]}"'
        parts.append(f'<polyline {line} stroke-width="0.04"{dash}/>')
    parts.append(f'<circle cx="{goal_x}" cy="{-goal_y}" r="0.1" fill="none" stroke="#080" stroke-width="0.04"/>')
    for index, name in enumerate(dict.fromkeys(row["simulator"] for row in rows)):
        place = f'x="{left + 0.5 + 3 * index:.2f}" y="{-low - height + 0.55:.2f}" font-size="0.35"'
        parts.append(f'<text {place} fill="{COLOURS[name]}">{name}, dashed with errors</text>')
    view = f"{left:.2f} {-low - height:.2f} {width:.2f} {height:.2f}"
    head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="{view}" font-family="sans-serif">'
    return head + "\n".join(parts) + "</svg>\n"


def points(places):
    """Places as the points of a line in a picture, whose y is downwards."""
    return " ".join(f"{x:.2f},{-y:.2f}" for x, y in places)
