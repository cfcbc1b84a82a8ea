"""Times focus measures in OpenCV and in Parfocal, one after the other on the same picture, and prints the ratios.

    python3 -m venv venv && venv/bin/pip install opencv-python-headless==4.14.0.94 numpy
    cargo build --release
    venv/bin/python benches/peers/focus_opencv.py [--parfocal target/release/parfocal] [--rounds 5] [--json]

One thread each; the picture (2448x2048, 8 bits) is in the cache. A round times each measure in OpenCV, then in Parfocal,
each as the median of several runs; the ratio is that of the medians over the rounds. On a machine that others use as well
longer runs are interrupted more often, so OpenCV's time is that of its thread alone, Parfocal's is by the clock on the wall: what
interrupts counts against Parfocal only. 'At best' compares the fastest rounds. For OpenCV the fastest idiom that we
know is taken, with its outputs allocated beforehand (its own dot product of 8-bit pictures is not reachable from Python). Parfocal sums over the pixels with a whole neighbourhood, OpenCV
invents a border of one pixel; that is 0.2 % of the work. Values are compared too, where both compute the same.
"""

import argparse
import json
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import cv2
import numpy as np

WIDTH, HEIGHT = 2448, 2048


def picture():
    """Waves of two lengths with noise, like the picture of `parfocal focus bench`."""
    x, y = np.arange(WIDTH)[None, :], np.arange(HEIGHT)[:, None]
    noise = np.random.default_rng(1).random((HEIGHT, WIDTH))
    return (120 + 60 * np.sin(x / 37) + 50 * np.cos(y / 23) + 9 * noise).astype(np.uint8)


def idioms(grey):
    """For each measure its OpenCV idioms by name; the fastest counts. The last of a list is exact algebra that an
    expert may think of; it is shown, and counts as well where it is an idiom of the measure itself."""
    here, near, far = grey[:, :-2], grey[:, 1:-1], grey[:, 2:]
    a16 = np.empty((HEIGHT, WIDTH), np.int16)
    b16 = np.empty((HEIGHT, WIDTH), np.int16)
    narrow16 = np.empty((HEIGHT, WIDTH - 2), np.int16)
    narrow32 = np.empty((HEIGHT, WIDTH - 2), np.float32)
    pixels = WIDTH * HEIGHT
    triples = (WIDTH - 2) * HEIGHT

    def square(*planes):
        return cv2.norm(*planes, cv2.NORM_L2SQR)

    def variance_of_laplacian():
        cv2.Laplacian(grey, cv2.CV_16S, dst=a16, ksize=1)
        return cv2.meanStdDev(a16)[1][0, 0] ** 2

    def laplacian_and_norm():
        cv2.Laplacian(grey, cv2.CV_16S, dst=a16, ksize=1)
        return square(a16) / pixels - (cv2.sumElems(a16)[0] / pixels) ** 2

    def sobel():
        cv2.Sobel(grey, cv2.CV_16S, 1, 0, dst=a16)
        cv2.Sobel(grey, cv2.CV_16S, 0, 1, dst=b16)
        return (square(a16) + square(b16)) / pixels

    def spatial_gradient():
        cv2.spatialGradient(grey, a16, b16)
        return (square(a16) + square(b16)) / pixels

    def brenner():
        return square(far, here) / triples

    def normalised_variance():
        mean, deviation = cv2.meanStdDev(grey)
        return deviation[0, 0] ** 2 / mean[0, 0]

    def norm_and_sum():
        mean = cv2.sumElems(grey)[0] / pixels
        return (square(grey) / pixels - mean**2) / mean

    def multiply_and_sum():
        cv2.subtract(near, far, dst=narrow16, dtype=cv2.CV_16S)
        cv2.multiply(here, narrow16, dst=narrow32, dtype=cv2.CV_32F)
        return cv2.sumElems(narrow32)[0] / triples

    def four_norms():
        # 2ab = a² + b² − (a − b)², so the product sums become norms.
        return (square(near) - square(far) - square(here, near) + square(here, far)) / 2 / triples

    def two_norms():
        # As above; of near² − far² only the columns at both ends remain.
        ends = square(grey[:, 1]) - square(grey[:, -1])
        return (ends - square(here, near) + square(here, far)) / 2 / triples

    def entropy():
        share = cv2.calcHist([grey], [0], None, [256], [0, 256]).ravel() / pixels
        share = share[share > 0]
        return -float((share * np.log2(share)).sum())

    return {
        "variance-of-laplacian": [variance_of_laplacian, laplacian_and_norm],
        "vollath-f4": [multiply_and_sum, four_norms, two_norms],
        "tenengrad": [sobel, spatial_gradient],
        "brenner": [brenner],
        "normalised-variance": [normalised_variance, norm_and_sum],
        "entropy": [entropy],
    }


def median_ms(function, runs):
    function()
    times = []
    for _ in range(runs):
        start = time.thread_time()
        function()
        times.append((time.thread_time() - start) * 1e3)
    return statistics.median(times)


def parfocal(command):
    return json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)["results"][0]


def main():
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--parfocal", default="target/release/parfocal", help="the command, built with --release")
    options.add_argument("--rounds", type=int, default=5)
    options.add_argument("--runs", type=int, default=25, help="runs a round, whose median counts")
    options.add_argument("--json", action="store_true")
    given = options.parse_args()
    cv2.setNumThreads(1)
    grey = picture()
    results = []
    with tempfile.TemporaryDirectory() as folder:
        file = str(Path(folder) / "picture.png")
        cv2.imwrite(file, grey, [cv2.IMWRITE_PNG_COMPRESSION, 1])
        for measure, functions in idioms(grey).items():
            ours = [given.parfocal, "focus", "bench", "--json", "--picture", file, "--measure", measure]
            peers = {f.__name__: [] for f in functions}
            own = []
            for _ in range(given.rounds):
                for function in functions:
                    peers[function.__name__].append(median_ms(function, given.runs))
                own.append(parfocal([*ours, "--runs", str(given.runs)])["ms"])
            value = parfocal([given.parfocal, "focus", "measure", "--json", file, "--measure", measure])["phi"]
            for function in functions:
                peer = function()
                # Borders differ by a pixel, single precision by rounding.
                if abs(peer - value) > 0.01 * abs(value):
                    sys.exit(f"{measure}: {function.__name__} gives {peer}, Parfocal {value}")
                ms = statistics.median(peers[function.__name__])
                mine = statistics.median(own)
                results.append(
                    {
                        "measure": measure,
                        "idiom": function.__name__,
                        "opencv_ms": ms,
                        "parfocal_ms": mine,
                        "ratio": ms / mine,
                        "ratio_at_best": min(peers[function.__name__]) / min(own),
                    }
                )
    if given.json:
        print(json.dumps({"opencv": cv2.__version__, "width": WIDTH, "height": HEIGHT, "results": results}))
        return
    print(f"OpenCV {cv2.__version__}, {WIDTH}x{HEIGHT} 8-bit, one thread, median of {given.rounds} interleaved rounds")
    print(f"{'measure':<24}{'OpenCV idiom':<24}{'OpenCV ms':>10}{'Parfocal ms':>13}{'faster':>9}{'at best':>9}")
    for r in results:
        print(f"{r['measure']:<24}{r['idiom']:<24}{r['opencv_ms']:>10.3f}{r['parfocal_ms']:>13.3f}{r['ratio']:>8.2f}x{r['ratio_at_best']:>8.2f}x")


if __name__ == "__main__":
    main()
