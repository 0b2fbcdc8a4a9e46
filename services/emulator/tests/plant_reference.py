#!/usr/bin/env python3
"""Integrates manoeuvres of the emulated robot with SciPy, independently of the emulator, for plant_reference.rs.

    python3 plant_reference.py > plant_reference.csv

DOP853 with relative tolerance 1e-12 and absolute tolerance 1e-13. An integration ends where a command changes, and where
a rate reaches or leaves its limit or the sliding robot stands still, so that no step covers a kink.
"""
from math import cos, sin, tanh

from scipy.integrate import solve_ivp

M, LH, LV, C, J = 14.695, 0.1924, 0.1776, 250.0, 0.5024
TAU_V, A_ACC, A_DEC, TAU_S, RATE = 0.15, 2.0, 3.0, 0.1, 0.5
SLOWEST, G = 0.05, 9.81


def axle(slip, limit):
    return C * slip if limit == 0.0 else limit * tanh(C * slip / limit)


def motion(state, speed, steering, mu):
    """Single-track model from slip angles and forces."""
    sideslip, yaw, rate = state[:3]
    u = max(speed, SLOWEST)
    front = axle(steering - sideslip - LV * rate / u, mu * M * G * LH / (LH + LV))
    rear = axle(-steering - sideslip + LH * rate / u, mu * M * G * LV / (LH + LV))
    return [
        cos(steering) * (front + rear) / (M * u * cos(sideslip)) - rate,
        rate,
        cos(steering) * (front * LV - rear * LH) / J,
        speed * cos(sideslip + yaw),
        speed * sin(sideslip + yaw),
    ]


def clamp(value, low, high):
    return min(max(value, low), high)


def drive(mu, lag, desired):
    def rates(_, y):
        v, a = (0.0, 0.0)
        if lag:
            v = clamp((desired[0] - y[5]) / TAU_V, -A_DEC, A_ACC)
            a = clamp((desired[1] - y[6]) / TAU_S, -RATE, RATE)
        return motion(y, y[5], y[6], mu) + [v, a]

    kinks = []
    if lag:
        kinks = [
            lambda _, y: (desired[0] - y[5]) / TAU_V - A_ACC,
            lambda _, y: (desired[0] - y[5]) / TAU_V + A_DEC,
            lambda _, y: (desired[1] - y[6]) / TAU_S - RATE,
            lambda _, y: (desired[1] - y[6]) / TAU_S + RATE,
            lambda _, y: y[5] - SLOWEST,
        ]
    return rates, kinks


def slide(mu):
    deceleration = min(5.0, mu * G) if mu > 0.0 else 5.0

    def rates(_, y):
        return motion(y, y[5], y[6], mu) + [-deceleration, 0.0]

    def rest(_, y):
        return y[5]

    return rates, [lambda _, y: y[5] - SLOWEST, rest]


def run(rates, kinks, y, duration):
    """Integrates from kink to kink."""
    time = 0.0
    while time < duration:
        for kink in kinks:
            kink.terminal = True
        result = solve_ivp(rates, (time, duration), y, method="DOP853", rtol=1e-12, atol=1e-13, events=kinks, max_step=0.01)
        time, y = result.t[-1], list(result.y[:, -1])
        if result.status == 1:
            if rates.__qualname__.startswith("slide") and y[5] < 1e-9:
                return [0.0, y[1], 0.0, y[3], y[4], 0.0, y[6]]
            # Past the kink, by less than the tolerance.
            step = 1e-10
            slope = rates(time, y)
            y = [value + step * rate for value, rate in zip(y, slope)]
            time += step
    return y


# name, friction, lag, [(seconds, desired speed and steering angle, or None for blocked wheels)]
MANOEUVRES = [
    ("ideal-turns", 0.0, False, [(1.0, (0.7, 0.05)), (0.8, (1.0, -0.06)), (0.5, (0.1, 0.06))]),
    ("ideal-block", 0.0, False, [(1.0, (1.0, 0.06)), (0.3, None)]),
    ("tyres-turns", 0.8, False, [(1.0, (0.7, 0.05)), (0.8, (1.0, -0.06)), (0.5, (0.2, 0.06))]),
    ("tyres-slide", 0.03, False, [(2.0, (1.0, 0.06)), (1.0, (1.0, -0.06))]),
    ("lag-start", 0.0, True, [(1.0, (1.0, 0.06))]),
    ("summit-slalom", 0.8, True, [(1.0, (1.0, 0.06)), (0.5, (0.9, -0.06)), (0.5, (0.3, 0.06)), (1.0, (1.0, 0.0))]),
    ("summit-brake", 0.8, True, [(1.2, (1.0, 0.03)), (0.6, (0.1, 0.06))]),
    ("summit-block", 0.8, True, [(0.25, (1.0, 0.06)), (0.05, None), (0.5, (0.6, -0.03)), (0.4, None)]),
    ("ice-block", 0.05, True, [(1.5, (1.0, 0.06)), (1.0, None)]),
]

print("manoeuvre,friction,lag,seconds,velocity,steering,sideslip,yaw,yaw_rate,x,y,speed,angle")
for name, mu, lag, parts in MANOEUVRES:
    y = [0.0] * 7
    for seconds, desired in parts:
        if desired is None:
            y = run(*slide(mu), y, seconds)
        else:
            if not lag:
                y[5:] = desired
            y = run(*drive(mu, lag, desired), y, seconds)
        wanted = ",".join(map(repr, desired)) if desired else "block,block"
        print(",".join([name, repr(mu), str(int(lag)), repr(seconds), wanted] + [f"{value:.15g}" for value in y]))
