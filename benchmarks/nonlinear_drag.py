"""How good the two forms of equivalent damping and harmonic balance are: motion in time, exponents, convergence.

    python benchmarks/nonlinear_drag.py [--particles 1024] [--seeds 5] [--only errors|slopes|floor|points]

Prints the tables of docs/howto/drag.md. δσ = 1 throughout: only X = ω^α δσ^(α−1) counts. Paths in time are
followed until they close after half a cycle, u(t + T/2) = −u(t). Errors of slopes are those over packings.

Axes: c contact, d degree of freedom.
"""

import argparse
import time
from collections import defaultdict
from pathlib import Path

import numpy as np

import petscjam as pj
from petscjam.analysis.drag import equivalent_time
from petscjam.analysis.scaling import power_law
from petscjam.reference import linear as reference

EXPONENTS = {"2/3": 2 / 3, "1/2": 1 / 2}
SIXTEEN = Path(__file__).parents[1] / "tests/data/jambashbulk-N16-P1e-3-0001.txt"
X_IN_TIME = np.geomspace(1e-4, 10, 11)
STEPS, CLOSED, MOST = 64, 1e-4, 24  # time steps of half a cycle; when a path is closed; half cycles at most
PRESSURES = (1e-2, 1e-3, 1e-4)
CRITICAL = (5, 0.1)  # ωτ, from so many times p to this
X_OF_POINTS, POINTS, REFERENCE = np.array([1e-6, 1e-4, 1e-2, 1.0]), (16, 32, 64), 256
X_OF_SLOPES, QUASISTATIC = np.geomspace(1e-4, 1, 25), np.array([1e-6])


# ---- motion in time


def in_diameters(packing):
    """Return the same packing of harmonic disks, its lengths in mean diameters."""
    d = packing.mean_diameter
    return pj.Packing(packing.positions / d, packing.radii / d, pj.Box(packing.box.cell / d))


def contacts(packing):
    """Return those of the backbone."""
    found = reference.contacts(packing.positions, packing.radii, packing.box.cell, packing.potential)
    return reference.without_rattlers(found, len(packing))


def equations(packing, prestress):
    """Return K (d, d), A (C, 2, d) with Au̇ = (Δu̇∥, Δu̇⊥), and f (d,); one disk of the backbone is held.

    Lengths are in mean diameters, the ρ0 of the law.
    """
    packing = in_diameters(packing)
    found = contacts(packing)
    A = np.array([reference.rows(c, packing.radii, "simple-shear", arms=1) for c in found])
    free = np.flatnonzero(A.any((0, 1)))[2:]
    K = reference.hessian(found, packing.radii, prestress=prestress)
    f = np.zeros(len(free))
    f[-1] = packing.box.area
    return K[np.ix_(free, free)], A[:, :, free], f


def path_in_time(K, A, f, alpha, omega, tau):
    """Return the fundamental (d,) of Ku + Σ Aᵀ|Au̇|^(α−1)Au̇ = f cos ωt, and by how much the path is open.

    The implicit midpoint rule from the linear motion with the times τ (C,): each step minimises a convex
    function of u̇, by Newton's method. Half a cycle brings u0 to Φ(u0), and u0 = −Φ(u0) is wanted. What decays
    fast is gone after −Φ(u0), what decays slowly after the mean of both: these take turns.
    """
    both, dt = A.reshape(-1, len(K)), np.pi / omega / STEPS
    first = np.linalg.solve(K + 1j * omega * np.einsum("c,ckd,cke->de", tau, A, A), f)
    u, v = first.real, (1j * omega * first).real
    tiny = 1e-10 * omega**2 * np.mean(abs(both @ first) ** 2)
    times = dt * (np.arange(STEPS) + 0.5)
    for half in range(MOST):
        start, path = u, []
        for t in times:
            v = _velocity(v, K * dt / 2, A, K @ u - f * np.cos(omega * t), alpha, tiny, 1e-9 * abs(f).max())
            path.append(u + v * dt / 2)
            u = u + v * dt
        end, u, v = u, -u, -v
        fundamental = 2 / STEPS * np.exp(-1j * omega * times) @ path
        is_open = np.linalg.norm(end + start) / np.linalg.norm(fundamental)
        if is_open < CLOSED:
            break
        if half % 2:
            u = (start - end) / 2
    return fundamental, is_open


def _velocity(v, S, A, rest, alpha, tiny, small):
    """Minimise Σ|Av|^(α+1)/(α+1) + v·Sv/2 + v·rest from ``v``; a step ends before the slope has turned up."""
    both = A.reshape(-1, len(S))

    def parts(v):
        w = (both @ v).reshape(-1, 2)
        square = (w**2).sum(1) + tiny
        rub = square ** ((alpha - 1) / 2)
        return w, square, rub, both.T @ (rub[:, None] * w).ravel() + rest + S @ v

    for _ in range(200):
        w, square, rub, force = parts(v)
        if abs(force).max() < small:
            return v
        along = np.eye(2) + (alpha - 1) * w[:, :, None] * w[:, None, :] / square[:, None, None]
        rubbed = (rub[:, None, None] * along @ A).reshape(both.shape)
        move = -np.linalg.solve(both.T @ rubbed + S, force)
        while parts(v + move)[3] @ move > -0.1 * force @ move:
            move = move / 2
        v = v + move
    raise RuntimeError("a step did not converge")


def print_errors():
    """Print the largest error of each form against the motion in time."""
    spring = np.eye(1), np.array([[[1.0], [0.0]]]), np.ones(1)
    packings = {"16 disks": (pj.import_packing(SIXTEEN), True), "64 disks": (pj.prepare_packing(64, 1e-4, 1), False)}
    cells, spans, gaps = defaultdict(list), defaultdict(list), []

    def true(parts, alpha, omegas, taus):
        paths = [path_in_time(*parts, alpha, w, tau) for w, tau in zip(omegas, taus, strict=True)]
        gaps.extend(is_open for _, is_open in paths)
        return 1 / np.array([u[-1] for u, _ in paths])

    for alpha in EXPONENTS.values():
        omegas = X_IN_TIME ** (1 / alpha)
        tau = equivalent_time(omegas, 1.0, alpha)
        cells["one spring"].append(_errors(1 + 1j * omegas * tau, true(spring, alpha, omegas, tau[:, None])))
        spans["one spring"].append(omegas * tau)
        for name, (packing, prestress) in packings.items():
            each = pj.self_consistent_drag(packing, omegas, 1.0, alpha, prestress=prestress)
            one = pj.equivalent_drag(packing, omegas, 1.0, alpha, prestress=prestress)
            taus = each.contact_tau[:, _order(packing)]
            G = true(equations(packing, prestress), alpha, omegas, taus)
            cells[f"{name}, a time for each contact"].append(_errors(each.values, G))
            cells[f"{name}, one time"].append(_errors(one.values, G))
            direct = pj.nonlinear_drag(packing, omegas, 1.0, alpha, prestress=prestress)
            cells[f"{name}, harmonic balance"].append(_errors(direct.values, G))
            spans[name].append(omegas * each.tau)
    print("| largest error of G\\*, and of G″ | " + " | ".join(f"α = {a}" for a in EXPONENTS) + " |")
    print("|---|" + "---|" * len(EXPONENTS))
    for name, row in cells.items():
        print(f"| {name} | " + " | ".join(row) + " |")
    for name, both in spans.items():
        print(f"{name}: ωτ from {np.min(both):.1e} to {np.max(both):.1e}")
    print(f"paths are open by at most {max(gaps):.0e}")


def _errors(values, true):
    """Return the largest |ΔG*|/|G*| and |ΔG″|/G″."""
    return f"{abs(values / true - 1).max():.2%}, {abs(values.imag / true.imag - 1).max():.2%}"


def _order(packing):
    """Return which contact of the network each contact of the slow twin is."""
    network = pj.ContactNetwork.of(packing).without_rattlers()
    known = [(i, j, *r) for i, j, r in zip(network.i, network.j, network.r.round(6), strict=True)]
    where = {key: c for c, (i, j, x, y) in enumerate(known) for key in ((i, j, x, y), (j, i, -x, -y))}
    return [where[c.i, c.j, round(c.rx, 6), round(c.ry, 6)] for c in contacts(packing)]


# ---- exponents


def print_slopes(particles, seeds):
    """Print the exponents that each form has, without pre-stress."""
    packings = [[pj.prepare_packing(particles, p, seed) for seed in range(1, seeds + 1)] for p in PRESSURES]
    print("| | one time | expected | each contact | expected |")
    print("|---|---|---|---|---|")
    solves = {}
    for name, alpha in EXPONENTS.items():
        critical, quasistatic = [], []
        for drag in (pj.equivalent_drag, pj.self_consistent_drag):

            def found(packing, X, drag=drag, alpha=alpha):
                return drag(packing, X ** (1 / alpha), 1.0, alpha, prestress=False)

            lowest = [found(packing, X_OF_SLOPES) for packing in packings[-1]]
            losses = [[found(packing, QUASISTATIC).values.imag[0] for packing in some] for some in packings]
            critical.append(_critical(lowest, PRESSURES[-1]))
            quasistatic.append(power_law(PRESSURES, losses))
        solves[name] = np.mean([g.iterations for g in lowest])
        one, each = critical
        print(f"| critical, α = {name} | {one} | {alpha / 2:.2f} | {each} | {2 * alpha / (1 + 3 * alpha):.2f} |")
        one, each = (f"{fit.exponent:.3f} ± {fit.error:.3f}" for fit in quasistatic)
        print(f"| quasi-static, α = {name} | {one} | −0.50 | {each} | {(1 - 3 * alpha) / 4:.3f} |")
    for name, mean in solves.items():
        print(f"α = {name}: {mean:.1f} solves a frequency")


def _critical(some, p):
    """Return the slope against ω, the mean over G′, G″ and packings."""
    slopes = []
    for g in some:
        rate = g.omega * g.tau
        kept = (rate > CRITICAL[0] * p) & (rate < CRITICAL[1])
        parts = np.log(np.stack([g.values.real, g.values.imag], axis=1)[kept])
        slopes.append(np.polyfit(np.log(g.omega[kept]), parts, 1)[0].mean())
    return f"{np.mean(slopes):.3f} ± {np.std(slopes, ddof=1) / len(slopes) ** 0.5:.3f}"


def print_floor(particles):
    """Print by how much a higher floor of the velocities moves G*."""
    packing = pj.prepare_packing(particles, 1e-4, 1)
    for name, alpha in EXPONENTS.items():
        omegas = np.geomspace(1e-4, 1, 5) ** (1 / alpha)
        settings = {"prestress": False, "rtol": 1e-9}
        low, *higher = (
            pj.self_consistent_drag(packing, omegas, 1.0, alpha, floor=floor, **settings).values
            for floor in (1e-6, 1e-4, 1e-2)
        )
        moved = ", ".join(f"{abs(high / low - 1).max():.0e}" for high in higher)
        print(f"α = {name}: a floor of 1e-4, 1e-2 instead of 1e-6 moves G* by {moved}")


# ---- convergence of harmonic balance


def print_points(particles):
    """Print the errors of G′ and G″ against the number of times of a cycle."""
    packing = pj.prepare_packing(particles, 1e-4, 1)
    print("| α, times of a cycle | " + " | ".join(f"X = {x:.0e}" for x in X_OF_POINTS) + " | iterations |")
    print("|---|" + "---|" * (len(X_OF_POINTS) + 1))
    for name, alpha in EXPONENTS.items():
        found = {
            points: pj.nonlinear_drag(packing, X_OF_POINTS ** (1 / alpha), 1.0, alpha, prestress=False, points=points)
            for points in (*POINTS, REFERENCE)
        }
        for points in POINTS:
            pairs = zip(found[points].values, found[REFERENCE].values, strict=True)
            errors = [f"{abs(a.real / b.real - 1):.0e}, {abs(a.imag / b.imag - 1):.0e}" for a, b in pairs]
            most = found[points].iterations.max()
            print(f"| {name}, {points} | " + " | ".join(errors) + f" | {most} |")


def main():
    """Measure and print."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--particles", type=int, default=1024)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--only", choices=["errors", "slopes", "floor", "points"])
    options = parser.parse_args()
    parts = {
        "errors": print_errors,
        "slopes": lambda: print_slopes(options.particles, options.seeds),
        "floor": lambda: print_floor(options.particles),
        "points": lambda: print_points(options.particles),
    }
    for name, work in parts.items():
        if options.only in (None, name):
            start = time.perf_counter()
            work()
            print(f"{name}: {time.perf_counter() - start:.0f} s\n", flush=True)


if __name__ == "__main__":
    main()
