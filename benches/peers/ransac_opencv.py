"""Solves the sets of `cargo xtask bench ransac` with OpenCV's robust estimators and scores them by the same rules.

    python3 -m venv venv && venv/bin/pip install opencv-python-headless==4.14.0.94 numpy
    cargo xtask bench ransac --generate 1000 --sets sets.json --out ours.json
    venv/bin/python benches/peers/ransac_opencv.py --data sets.json [--ours ours.json] [--kind aff2]

2-D affine: estimateAffine2D with USAC_MAGSAC, and with RANSAC. 3-D: estimateAffine3D, then least squares on its inliers (a rotation
for rig3). All get the set's tolerance; one thread. Times are of the call alone, around Python's overhead of a few µs.
With --ours the maps of Parfocal are scored here as well, by a program that shares nothing with it.
"""

import argparse
import collections
import json
import time

import cv2
import numpy as np

cv2.setNumThreads(1)
GRIDS = {2: ([200, 150], [5, 5]), 3: ([300, 300, 100], [5, 5, 3])}


def grid(d):
    """The places where maps are compared."""
    reach, steps = GRIDS[d]
    axes = [np.linspace(-r, r, s) for r, s in zip(reach, steps)]
    return np.stack([m.ravel() for m in np.meshgrid(*axes)], axis=1)


def least_squares(src, dst, rigid):
    """d x (d+1), from all points given; None when they do not determine it."""
    if rigid:
        a, b = src.mean(0), dst.mean(0)
        u, _, vt = np.linalg.svd((dst - b).T @ (src - a))
        r = u @ np.diag([1.0] * (len(a) - 1) + [np.sign(np.linalg.det(u @ vt))]) @ vt
        return np.column_stack([r, b - r @ a])
    if len(src) <= src.shape[1]:
        return None
    m, _, rank, _ = np.linalg.lstsq(np.column_stack([src, np.ones(len(src))]), dst, rcond=None)
    return m.T if rank == src.shape[1] + 1 else None


def error(m, truth):
    """RMS distance over the grid."""
    p = np.column_stack([grid(len(truth)), np.ones(len(grid(len(truth))))])
    return np.sqrt((((m - truth) @ p.T) ** 2).sum(0).mean())


def affine_2d(method):
    """estimateAffine2D by one method."""

    def solve(src, dst, tol, _rigid):
        m, _ = cv2.estimateAffine2D(src, dst, method=method, ransacReprojThreshold=tol, confidence=0.99, maxIters=2000)
        return m

    return solve


def affine_3d(src, dst, tol, rigid):
    """estimateAffine3D and least squares on its inliers."""
    found, m, inliers = cv2.estimateAffine3D(src, dst, ransacThreshold=tol, confidence=0.99)
    if not found:
        return None
    chosen = inliers.ravel() > 0
    return least_squares(src[chosen], dst[chosen], rigid)


METHODS = {
    2: {
        "OpenCV USAC_MAGSAC": affine_2d(cv2.USAC_MAGSAC),
        "OpenCV RANSAC": affine_2d(cv2.RANSAC),
    },
    3: {"OpenCV affine 3-D + refit": affine_3d},
}


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--data", required=True)
    parser.add_argument("--ours")
    parser.add_argument("--kind")
    options = parser.parse_args()
    sets = [s for s in json.load(open(options.data)) if options.kind in (None, s["kind"])]
    answers = {}
    if options.ours:
        answers = {(a["kind"], a["n"], a["out"], a["trial"]): a for a in json.load(open(options.ours))}
    rows = collections.defaultdict(list)
    for s in sets:
        src, dst = np.array(s["src"]), np.array(s["dst"])
        truth, good, rigid = np.array(s["truth"]), np.array(s["inlier"]) == 1, s["kind"] == "rig3"
        oracle = least_squares(src[good], dst[good], rigid)
        e_oracle = np.inf if oracle is None else error(oracle, truth)
        key = (s["kind"], s["n"], s["out"])

        def add(name, m, us, ambiguous=False):
            e = np.inf if m is None else error(np.array(m), truth)
            rows[key, name].append((e <= max(s["sigma"], 2 * e_oracle), ambiguous, e / e_oracle, us))

        if answers:
            a = answers[s["kind"], s["n"], s["out"], s["trial"]]
            add("Parfocal", a["M"], a["us"], a.get("ambiguous", False))
        for name, solve in METHODS[src.shape[1]].items():
            start = time.perf_counter()
            m = solve(src, dst, s["tol"], rigid)
            add(name, m, (time.perf_counter() - start) * 1e6)
    print(f"{'kind   n  wrong':16} {'method':26} {'sets':>5} solved% ambiguous% failed% | ratio median    p95 | us median")
    for ((kind, n, out), name), list_ in sorted(rows.items(), key=lambda r: (r[0][0], r[0][1] != "Parfocal", r[0][1])):
        solved = 100 * np.mean([ok and not amb for ok, amb, _, _ in list_])
        ambiguous = 100 * np.mean([amb for _, amb, _, _ in list_])
        ratios = [r for _, amb, r, _ in list_ if not amb and np.isfinite(r)] or [np.nan]
        us = np.median([us for *_, us in list_])
        print(
            f"{kind} {n:>4} {out * 100:>4.0f} %  {name:26} {len(list_):>5} {solved:>7.1f} {ambiguous:>10.1f} "
            f"{100 - solved - ambiguous:>7.1f} | {np.median(ratios):>12.3f} {np.quantile(ratios, 0.95):>6.3f} | {us:>9.1f}"
        )


if __name__ == "__main__":
    main()
