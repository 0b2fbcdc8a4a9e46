"""Whether a robot can drive past the bodies of a world that rest: a search that knows nothing of Scanloop."""

import heapq
import math

import shapely
import shapely.affinity
from surroundings import around

RADIUS_M, MARGIN_M, STEP_M = 3.2, 0.1, 0.25
GRID_M, GRID_RAD = 0.05, math.radians(2)
EDGE_M, TOLERANCE_M = 2.4, 0.1


def shape_of(body):
    """The outline of a body."""
    if "polygon" in body:
        return shapely.Polygon(body["polygon"])
    if "radius" in body:
        return shapely.Point(body["at"]).buffer(body["radius"])
    (x, y), (length, width) = body["at"], body["size"]
    box = shapely.box(x - length / 2, y - width / 2, x + length / 2, y + width / 2)
    return shapely.affinity.rotate(box, body.get("yaw", 0.0), use_radians=True)


def line_of(course):
    """The line through waypoints (x, y, yaw), with bends about as tight as arcs."""
    places = []
    for (x, y, yaw), (to_x, to_y, to_yaw) in zip(course, course[1:]):
        far = math.hypot(to_x - x, to_y - y)
        for share in (step / 20 for step in range(21)):
            began, begin = 2 * share**3 - 3 * share**2 + 1, share**3 - 2 * share**2 + share
            ended, end = 3 * share**2 - 2 * share**3, share**3 - share**2
            across = [(x, math.cos(yaw), to_x, math.cos(to_yaw)), (y, math.sin(yaw), to_y, math.sin(to_yaw))]
            places.append([began * p + far * (begin * d + end * to_d) + ended * to_p for p, d, to_p, to_d in across])
    return shapely.LineString(places)


def is_passable(world, length_m, width_m):
    """Whether a way leads to the goal, or the course does, on which the body keeps a decimetre to all bodies at rest and
    all walls."""
    if "course" in world:
        bodies = shapely.union_all([shape_of(body) for body in world["bodies"] + around(world)])
        return not line_of(world["course"]).buffer(width_m / 2 + MARGIN_M).intersects(bodies)
    goal_x, goal_y = world["goal"]
    still = [shape_of(body) for body in world["bodies"] if "velocity" not in body]
    # In the open the way ends where the track does.
    edges = [{"at": [goal_x / 2, side * EDGE_M], "size": [goal_x + 18, 0.2]} for side in (1, -1)]
    walls = [shape_of(body) for body in around(world) + edges]
    taken = shapely.union_all([shape.buffer(MARGIN_M) for shape in still + walls])
    shapely.prepare(taken)
    robot = shapely.box(-length_m / 2, -width_m / 2, length_m / 2, width_m / 2)
    waiting, known = [(goal_x, 0.0, 0.0, 0.0)], set()
    while waiting:
        _, x, y, yaw = heapq.heappop(waiting)
        if math.hypot(x - goal_x, y - goal_y) <= STEP_M / 2 + TOLERANCE_M:
            return True
        for curvature in (0.0, 1 / RADIUS_M, -1 / RADIUS_M):
            turn = curvature * STEP_M
            to = x + STEP_M * math.cos(yaw + turn / 2), y + STEP_M * math.sin(yaw + turn / 2), yaw + turn
            place = round(to[0] / GRID_M), round(to[1] / GRID_M), round(to[2] / GRID_RAD)
            if place in known or to[0] > goal_x + 0.5 or abs(to[2]) > 1.2:
                continue
            known.add(place)
            body = shapely.affinity.rotate(robot, to[2], origin=(0, 0), use_radians=True)
            if not taken.intersects(shapely.affinity.translate(body, to[0], to[1])):
                rest = math.hypot(goal_x - to[0], goal_y - to[1])
                heapq.heappush(waiting, (rest, *to))
    return False
