"""scipy.optimize.least_squares over the reference model, its right-hand side compiled by numba.

    python fit.py DIR        # DIR: problem.json and data.f64 as against_scipy writes them; prints {seconds, cost, theta, ...}

Equations, units, parameters: docs/CAMPAIGN.md. Classical Runge-Kutta in the steps of this project's integrator (1 ms where the lever is
free, 10 ms where it is led).
"""

import json
import math
import os
import sys
import time

DIR = sys.argv[1]
PROBLEM = json.load(open(os.path.join(DIR, "problem.json")))
os.environ["NUMBA_NUM_THREADS"] = str(PROBLEM["threads"])

import numba
import numpy as np
from scipy.optimize import least_squares

FREE, LED, SHUT_OFF, DRAINED, BENCH = range(5)
M1, M2, M3, H1, H2, H3, A1, A2, V1, V2, F1, F2, F3, F4, L1, L2, L3, L4, A, J, G, K_B = range(22)
DEGREES = 180.0 / math.pi


@numba.njit(cache=False, fastmath=False)
def derivative(stand, vertical, u, brake, bypass, w_led, rate1, rate2, k, x, dx):
    """States: angle (rad), velocity (rad/s), pressures (bar), volume (ml). Returns the torque on the lever, Nm."""
    phi, p1, p2 = x[0], x[2], x[3]
    w = x[1] if stand == FREE else w_led
    dp = p1 - p2
    flow = 0.0
    if stand != SHUT_OFF and stand != DRAINED:
        drive = k[F1] * abs(u) + k[F4] + k[F2] * u * dp
        flow = k[F3] * dp
        if drive > 0.0 and u != 0.0:
            flow += drive if u > 0.0 else -drive
        flow *= brake
        if bypass > 0.0 and stand != BENCH:
            flow -= k[K_B] * dp
    torque = (k[M1] * abs(dp) + k[M2]) * phi + k[M3] * dp
    if vertical:
        torque -= k[G] * math.sin(phi)
    if stand == BENCH:
        dx[0] = dx[1] = dx[2] = dx[3] = 0.0
        dx[4] = -flow if u < 0.0 else flow
        return torque
    bend = math.exp(k[A1] * phi * DEGREES)
    c1 = (k[H1] * p1 ** k[H2] + k[H3]) / bend
    c2 = (k[H1] * p2 ** k[H2] + k[H3]) * bend
    v1, v2 = k[V1] * phi + k[V2], k[V1] * phi - k[V2]
    dx[0] = w
    dx[4] = 0.0
    if stand == DRAINED:
        dx[2], dx[3] = rate1, rate2
        dx[4] = -c1 * rate1 - v1 * w
    else:
        dx[2] = (flow - v1 * w) / c1
        dx[3] = (-flow - v2 * w) / c2
    dx[1] = 0.0
    if stand == FREE:
        if abs(w) < k[A]:
            loss = k[L4] * w
        elif w > 0.0:
            loss = (k[L1] * w + k[L2]) * w + k[L3]
        else:
            loss = (-k[L1] * w + k[L2]) * w - k[L3]
        dx[1] = (torque - loss) / k[J]
    return torque


@numba.njit(cache=False)
def residuals(k, columns, first, rows, stand, vertical, initial, blocks, first_block, std, first_target, out, s):
    """Weighted residuals of stretch `s` into `out`."""
    a = first[s]
    n = rows[s]
    t, u, brake, bypass, angle, q1, q2 = columns[:7, a : a + n]
    x, y, dx1, dx2, dx3, dx4 = (np.zeros(5), np.zeros(5), np.zeros(5), np.zeros(5), np.zeros(5), np.zeros(5))
    x[0], x[2], x[3] = initial[s, 0], initial[s, 1], initial[s, 2]
    longest = 1e-3 if stand[s] == FREE else 1e-2
    sums, counts, seen = np.zeros(5), np.zeros(5), np.zeros(5)
    measured_sum = np.zeros(5)
    block = first_block[s]
    target = first_target[s]
    for i in range(n):
        j = min(i, n - 2)
        dt = t[j + 1] - t[j]
        if stand[s] != FREE:
            x[0] = angle[i]
        w_led = rate1 = rate2 = 0.0
        if stand[s] != FREE and stand[s] != BENCH:
            w_led = (angle[j + 1] - angle[j]) / dt
        if stand[s] == DRAINED or stand[s] == BENCH:
            x[2], x[3] = q1[i], q2[i]
            rate1, rate2 = (q1[j + 1] - q1[j]) / dt, (q2[j + 1] - q2[j]) / dt
        torque = derivative(stand[s], vertical[s], u[j], brake[j], bypass[j], w_led, rate1, rate2, k, x, dx1)
        seen[0], seen[1], seen[2], seen[3], seen[4] = x[0] * DEGREES, x[2], x[3], torque, x[4]
        for c in range(5):
            value = columns[7 + c, a + i]
            if not math.isnan(value):
                sums[c] += seen[c]
                measured_sum[c] += value
                counts[c] += 1.0
        if i + 1 == blocks[block + 1]:
            for c in range(5):
                if counts[c] > 0.0:
                    out[target] = (measured_sum[c] - sums[c]) / counts[c] / (std[s, c] / math.sqrt(counts[c]))
                    target += 1
                sums[c] = measured_sum[c] = counts[c] = 0.0
            block += 1
        if i + 1 < n:
            dt = t[i + 1] - t[i]
            steps = max(1, int(math.ceil(dt / longest - 1e-9)))
            h = dt / steps
            for step in range(steps):
                derivative(stand[s], vertical[s], u[i], brake[i], bypass[i], w_led, rate1, rate2, k, x, dx1)
                for c in range(5):
                    y[c] = x[c] + 0.5 * h * dx1[c]
                derivative(stand[s], vertical[s], u[i], brake[i], bypass[i], w_led, rate1, rate2, k, y, dx2)
                for c in range(5):
                    y[c] = x[c] + 0.5 * h * dx2[c]
                derivative(stand[s], vertical[s], u[i], brake[i], bypass[i], w_led, rate1, rate2, k, y, dx3)
                for c in range(5):
                    y[c] = x[c] + h * dx3[c]
                derivative(stand[s], vertical[s], u[i], brake[i], bypass[i], w_led, rate1, rate2, k, y, dx4)
                for c in range(5):
                    x[c] += h / 6.0 * (dx1[c] + 2.0 * dx2[c] + 2.0 * dx3[c] + dx4[c])
            if not (x[2] > 0.02 and x[3] > 0.02):
                for m in range(target, first_target[s + 1]):
                    out[m] = 1e6
                return


@numba.njit(parallel=True, cache=False)
def all_residuals(k, columns, first, rows, stand, vertical, initial, blocks, first_block, std, first_target, order, out):
    for n in numba.prange(len(order)):
        residuals(k, columns, first, rows, stand, vertical, initial, blocks, first_block, std, first_target, out, order[n])


def main():
    described = PROBLEM["stretches"]
    data = np.fromfile(os.path.join(DIR, "data.f64"), dtype="<f8")
    rows = np.array([s["rows"] for s in described], dtype=np.int64)
    first = np.concatenate([[0], np.cumsum(rows)]).astype(np.int64)
    columns = np.empty((12, int(first[-1])))
    at = 0
    for s, n in enumerate(rows):
        columns[:, first[s] : first[s] + n] = data[at : at + 12 * n].reshape(12, n)
        at += 12 * n
    stand = np.array([s["stand"] for s in described], dtype=np.int64)
    vertical = np.array([s["vertical"] for s in described])
    initial = np.array([s["initial"] for s in described])
    std = np.array([s["std"] for s in described])
    blocks = np.concatenate([s["blocks"] for s in described]).astype(np.int64)
    first_block = np.concatenate([[0], np.cumsum([len(s["blocks"]) for s in described])]).astype(np.int64)
    first_target = np.concatenate([[0], np.cumsum([s["targets"] for s in described])]).astype(np.int64)
    # the longest first, so that threads end together
    order = np.argsort(-rows).astype(np.int64)
    numba.set_num_threads(PROBLEM["threads"])

    base, fixed = PROBLEM["base"], np.array(PROBLEM["fixed"])

    def expand(theta):
        k = fixed.copy()
        k[base] = theta
        k[L4] = ((k[L1] * k[A] + k[L2]) * k[A] + k[L3]) / k[A]
        return k

    def fun(theta):
        out = np.empty(int(first_target[-1]))
        all_residuals(expand(theta), columns, first, rows, stand, vertical, initial, blocks, first_block, std, first_target, order, out)
        return out

    lower = np.array([-np.inf if b[0] is None else b[0] for b in PROBLEM["bounds"]])
    upper = np.array([np.inf if b[1] is None else b[1] for b in PROBLEM["bounds"]])
    start = np.array(PROBLEM["start"])
    # within the bounds, as scipy asks for
    start = np.minimum(np.maximum(start, lower + 1e-9 * (1 + np.abs(np.nan_to_num(lower)))), upper)
    fun(start)  # compiles
    begin = time.perf_counter()
    found = least_squares(fun, start, bounds=(lower, upper), x_scale="jac", method="trf", ftol=1e-6, xtol=1e-8, gtol=1e-8)
    seconds = time.perf_counter() - begin
    json.dump(
        {
            "seconds": seconds,
            "cost": 2.0 * found.cost,
            "theta": list(found.x),
            "evaluations": int(found.nfev),
            "status": int(found.status),
        },
        sys.stdout,
    )


main()
