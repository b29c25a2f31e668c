"""G*(ω) over ten decades from a few direct solves and a rational function, compared with the reduced model.

    python benchmarks/rational.py [--disks 1024]

For packings at three pressures, direct solves at n frequencies, evenly in ln ω, are interpolated by SciPy's AAA (in iω,
with the complex conjugates at −ω) and by the Floater–Hormann rational function (in ln ω). Prints the smallest n with an
error below 1e-6 at 401 frequencies, the errors at the n of the reduced model, and the reduced model with its bound.
"""

import argparse

import numpy as np
from scipy.interpolate import AAA, FloaterHormannInterpolator

import petscjam as pj

LOW, HIGH, FINE, GOAL = 1e-8, 1e2, 401, 1e-6
COUNTS = [*range(4, 31), *range(32, 61, 2), 70, 80, 101, 201]


def aaa(omega, values):
    """Return G*(ω) of AAA."""
    fit = AAA(np.concatenate([1j * omega, -1j * omega]), np.concatenate([values, values.conj()]), rtol=1e-13)
    return lambda x: fit(1j * x)


def floater_hormann(omega, values):
    """Return G*(ω) of the Floater–Hormann interpolant in ln ω."""
    fit = FloaterHormannInterpolator(np.log(omega), values, d=min(5, len(omega) - 1))
    return lambda x: fit(np.log(x))


def largest(G, omega, true):
    """Return the largest relative error."""
    return float(np.nanmax(np.abs(G(omega) / true - 1)))


def compare(packing, name):
    """Print the rows of a packing."""
    omega = np.geomspace(LOW, HIGH, FINE)
    true = pj.complex_modulus(packing, omega).values
    model = pj.spectrum(packing, (LOW, HIGH), rtol=GOAL)
    ours = model.factorisations
    line = f"| {name} | reduced model | {ours} | {largest(model, omega, true):.1e} | {model.error(omega).max():.1e} |"
    print(line, flush=True)
    for title, method in (("AAA", aaa), ("Floater–Hormann", floater_hormann)):
        errors = {}
        for n in COUNTS:
            some = np.geomspace(LOW, HIGH, n)
            errors[n] = largest(method(some, pj.complex_modulus(packing, some).values), omega, true)
            if errors[n] < GOAL:
                break
        needed = n if errors[n] < GOAL else f"> {n}"
        same = min(errors, key=lambda k: abs(k - ours))
        print(f"| {name} | {title} | {needed} | {errors[n]:.1e}; {errors[same]:.1e} with {same} | none |", flush=True)


def main():
    """Prepare the packings and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--disks", type=int, default=1024)
    disks = parser.parse_args().disks
    print("| packing | method | factorisations | largest error | bound |\n|---|---|---|---|---|")
    for p in (1e-2, 1e-3, 1e-4):
        compare(pj.prepare_packing(n=disks, pressure=p, seed=1), f"p = {p:g}")


if __name__ == "__main__":
    main()
