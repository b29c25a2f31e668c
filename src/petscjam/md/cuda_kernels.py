"""The loops of the disk MD on a GPU, compiled by numba-cuda, in double precision.

A run belongs to the threads of one block, or to all blocks. Thread t works on the disks t, t + threads, …: it reads
the neighbours from ``s``, where all disks are put before each evaluation of forces, and writes only its own disks.
Every disk has the list of all its neighbours, and sums its forces in the order of this list; a contact is seen from
both of its disks. Sums are kept by each thread, then added in a fixed order: a run repeats bit for bit.

Axes: run, i disk, c place in the list of a disk, t thread; of q and s: x, y, vx, vy, w = Rθ̇ (see kernels.py).
"""

from __future__ import annotations

import math
from collections import namedtuple
from functools import cache
from types import FunctionType
from typing import Any, NamedTuple

import numba
from numba import cuda, float32, float64, int32, uint32

from petscjam.md import contact as laws
from petscjam.md.engine import (
    BINS,
    DXX,
    DXY,
    DYX,
    DYY,
    EXX,
    EXY,
    EYY,
    HEAT,
    JUMPS,
    KXX,
    KXY,
    KYY,
    SUMS,
    TICKS,
    TOUCHING,
    WORK,
)

REGISTERS = 65536  # of a multiprocessor
SIMULATED: bool = numba.config.ENABLE_CUDASIM  # type: ignore[attr-defined]
# Numbers of a run
(LX, LY, SKIN, REACH, DT, NORMAL, TANGENTIAL, ROLLS, BODY, DRAG, FILM) = range(11)
# Integers of a launch: parts of steps to make (-1: no launch for this run), parts of a step, effect of a change of the
# rate, tick of the start, columns and rows of cells, whether contacts are those of the lists (1) or of ``open``,
# whether the sums at the start are counted already, and whether angles are kept.
(END, PARTS, BULK, TICK, COLUMNS, ROWS, GATHER, COUNTED, TURNS) = range(9)
# Results of a launch: parts of steps made, lists made, parts of steps before the last of them, parts of a step that the
# contacts require, whether the rate of the next part has begun, whether its sums are counted, and how the launch ended.
(MADE, BUILDS, BEGUN, DEMAND, CHANGED, HALFWAY, STATUS) = range(7)
(FINE, WIDEN, FULL, CROWDED, LOST, DIVERGED) = range(6)
# Sums of a state, after SUMS: elastic and rotational energy; over contacts vN², vT², their number, and the sums and
# products of V_T, V^R, V^C_T, V_N; then these four of one contact.
LOOKED = SUMS + 23
(ELASTIC, ROTATIONAL, SQUARES, SQUARES_T, NUMBER, FIRST, SECOND, ONE) = (*range(SUMS, SUMS + 6), SUMS + 9, SUMS + 19)
MASK, IMAGES = (1 << 26) - 1, 26  # a neighbour and its image, in one integer
HERE = 12  # the image of a neighbour that is a disk itself
NONE = (1 << 62) - 1
PLACES = 32  # of a list of neighbours
# Arrays on the card, by type, with their axes: R runs, N disks, M cells, C places of a cell, T threads and B blocks of
# a run. now, q: state, by disks and by components; F, home: forces, and positions at the last build; light = 1/m;
# angle, if it is kept; stress: P_xx, P_xy, P_yy times volume, half of each contact. The
# list: code (neighbour and image), inverse = 1/(Ri + Rj), gap = r²/(Ri + Rj)² at the build, since (tick of contact);
# count neighbours, of which bits touch; z contacts. open, began, held: disks in contact at a build, ticks of these
# contacts, their number. filled, members: disks in each cell. built: bounds of eigenvalues, and whole cells of strain
# left out, at the last build. state: how the launch ends, and the last check at which a disk had moved too far. angles,
# duration: events since the run began. course: strains at the beginnings of parts and at the end, and rates before and
# in them. s: what forces are computed from, if it is not in shared memory.
AXES = {
    "f8": "now: R 5N, q: R 5N, F: R 3N, R: R N, m: R N, light: R N, home: R 2N, angle: R N, stress: R 3N, "
    f"inverse: R 32N, built: R 3, numbers: R 13, course: R 2 L, s: R S, part: R {LOOKED} T, sums: R B {LOOKED}",
    "f4": "gap: R 32N",
    "i8": f"since: R 32N, began: 32 R N, angles: R 2 {BINS}, duration: R 1, orders: R 9, done: R 7, "
    "key: R T, keys: R B",
    "i4": "code: R 32N, count: R N, z: R N, open: 32 R N, held: R N, filled: R M, members: R C M, state: R 2",
    "u4": "bits: R N",
}
SHAPES = {
    name: (kind, axes.split())
    for kind, text in AXES.items()
    for name, axes in (item.split(": ") for item in text.split(", "))
}
Runs: Any = namedtuple("Runs", list(SHAPES))  # type: ignore[misc]


class Law(NamedTuple):
    """Friction coefficients, whether disks roll, and ``film`` of :func:`petscjam.md.contact.contact`."""

    normal: float
    tangential: float
    rolls: float
    body: float
    drag: float
    power: float
    scale: float
    cutoff: float


class Cell(NamedTuple):
    """Edges, shift and velocity of the row of images above, and γ̇."""

    Lx: float
    Ly: float
    slip: float
    slide: float
    rate: float


class Lists(NamedTuple):
    """The lists of one run."""

    code: Any
    inverse: Any
    since: Any
    count: Any
    bits: Any


if SIMULATED:

    def rsqrt(x):
        """Return 1/√x."""
        return 1.0 / math.sqrt(x)

    index: Any = int
    short: Any = int
    INLINE: dict[str, Any] = {}
else:
    from numba.cuda import libdevice

    rsqrt = libdevice.rsqrt
    index, short = uint32, int32  # an index from the end of an array is known to be none; conversions are faster
    INLINE = {"forceinline": True}


def _device(function):
    """Compile a function for the card, inside its callers."""
    return cuda.jit(device=True, **INLINE)(function)


@_device
def _cell_of(numbers, strain, turns, rate):
    """Return the cell at a strain; ``turns`` whole cells are left out."""
    return Cell(numbers[LX], numbers[LY], strain * numbers[LY] - turns * numbers[LX], rate * numbers[LY], rate)


@_device
def _lists_of(runs, run):
    """Return the lists of a run."""
    return Lists(runs.code[run], runs.inverse[run], runs.since[run], runs.count[run], runs.bits[run])


@_device
def law_of(numbers):
    """Return the law of a run."""
    return Law(
        numbers[NORMAL],
        numbers[TANGENTIAL],
        numbers[ROLLS],
        numbers[BODY],
        numbers[DRAG],
        numbers[FILM],
        numbers[FILM + 1],
        numbers[FILM + 2],
    )


@_device
def image(code):
    """Return the column and the row of the image of a neighbour."""
    return short((code >> IMAGES & 7) - 4), short((code >> IMAGES + 3) - 1)


@_device
def _separation(code, a, s, at, cell):
    """Return rji, vji with the image of j."""
    i, j = at + 5 * a, at + 5 * (code & MASK)
    right, up = image(code)
    x, y = s[j] - s[i] + right * cell.Lx + up * cell.slip, s[j + 1] - s[i + 1] + up * cell.Ly
    return x, y, s[j + 2] - s[i + 2] + up * cell.slide, s[j + 3] - s[i + 3]


@cache
def compiled(integrator: str, potential: Any, linear: bool, wide: bool, threads: int) -> tuple[Any, Any]:
    """Return the kernels ``advance`` and ``look``.

    Parameters
    ----------
    integrator : str
    potential : Potential
    linear : bool
        Whether the drag of contacts is linear.
    wide : bool
        One run by all blocks, with barriers across the grid; otherwise one run by each block.
    threads : int
        Of a multiprocessor, which share its registers.
    """
    kernel = cuda.jit if SIMULATED else cuda.jit(max_registers=REGISTERS // threads)
    alpha, absolute = potential.exponent, None if potential.relative else 1.0
    exponent = None if alpha == 2 else alpha
    heun, single = integrator == "heun", integrator == "single"
    dU, d2U, U = (None, None, None) if alpha else (1, 2, 0)
    power = alpha or 1.0

    if alpha:
        call = None
    else:
        call_U, call_dU, call_d2U = (_device(f) for f in (potential.U, potential.dU, potential.d2U))

        @_device
        def call(which, x):
            if which == 0:
                return 1.0 * call_U(x)
            if which == 1:
                return 1.0 * call_dU(x)
            return 1.0 * call_d2U(x)

    def on_card(function: Any) -> Any:
        return _device(FunctionType(function.__code__, {**function.__globals__, "call": call}))

    contact, stiffness, energy = on_card(laws.contact), on_card(laws.stiffness), on_card(laws.energy)
    angle_bin, fastest, largest = on_card(laws.angle_bin), on_card(laws.fastest), on_card(laws.largest)

    if linear:

        @_device
        def film_of(law):
            return None
    else:

        @_device
        def film_of(law):
            return law.power, law.scale, law.cutoff

    if wide:

        @_device
        def barrier():
            cuda.cg.this_grid().sync()
    else:

        @_device
        def barrier():
            cuda.syncthreads()

    @_device
    def events(a, n, s, at, lists, cell, tick, before, now, angles):
        """Record contacts of disk a that begin, or cease; return the durations. The first of both counts."""
        duration, changed = 0, index(before ^ now)
        while changed != 0:
            c = cuda.ffs(changed) - 1
            changed = index(changed & (changed - 1))
            place, touch = c * n + a, (now >> c) & 1 == 1
            code = lists.code[place]
            if touch:
                lists.since[place] = tick
            if a < code & MASK:
                if not touch:
                    duration += tick - lists.since[place]
                x, y, u, v = _separation(code, a, s, at, cell)
                cuda.atomic.add(angles, (0 if touch else 1, angle_bin(x, y, u, v)), 1)
        lists.bits[a] = now
        return duration

    @_device
    def force(a, n, s, at, R, lists, law, cell, tick, measure, angles):
        """Return force and torque on disk a, its share of the sums, and durations; with ``measure`` record events."""
        i = at + 5 * a
        x, y, u, v, w = s[i], s[i + 1], s[i + 2], s[i + 3], s[i + 4]
        fx = fy = ft = exx = exy = eyy = dxx = dxy = dyx = dyy = heat = couple = 0.0
        place, bit, now, duration = a, index(1), index(0), 0
        for _ in range(lists.count[a]):
            code, i1 = lists.code[place], lists.inverse[place]
            j = at + 5 * (code & MASK)
            rx, ry, slide = s[j] - x, s[j + 1] - y, 0.0
            if code >> IMAGES != HERE:
                right, up = image(code)
                rx += right * cell.Lx + up * cell.slip
                ry += up * cell.Ly
                slide = up * cell.slide
            r2 = rx * rx + ry * ry
            if r2 * i1 * i1 <= 1.0:
                turn = law.rolls * (w + s[j + 4]) * i1
                ux, uy = s[j + 2] - u + slide + turn * ry, s[j + 3] - v - turn * rx
                spring, gx, gy, _ = contact(
                    rx, ry, ux, uy, rsqrt(r2), i1, law.normal, law.tangential, film_of(law), exponent, absolute, dU
                )
                fx += gx - spring * rx
                fy += gy - spring * ry
                ft += i1 * (rx * gy - ry * gx)
                if measure:
                    exx += spring * rx * rx
                    exy += spring * rx * ry
                    eyy += spring * ry * ry
                    dxx -= gx * rx
                    dxy -= gx * ry
                    dyx -= gy * rx
                    dyy -= gy * ry
                    heat += gx * ux + gy * uy
                    now |= bit
            place, bit = place + n, index(bit + bit)
        ft *= 2.0 * law.rolls
        heat *= 0.5
        touching = cuda.popc(now)
        if measure:
            before = lists.bits[a]
            if now != before:
                duration = events(a, n, s, at, lists, cell, tick, before, now, angles)
        if law.body != 0.0 or law.drag != 0.0:
            cx, cy, spin = u - cell.rate * y, v, w / R[a] + 0.5 * cell.rate
            fx -= law.body * cx
            fy -= law.body * cy
            ft -= 2.0 * law.drag * spin / R[a]
            heat += law.body * (cx * cx + cy * cy) + law.drag * spin * spin
            couple = 0.5 * cell.rate * law.drag * spin
        return (
            (fx, fy, ft),
            (0.5 * exx, 0.5 * exy, 0.5 * eyy, 0.5 * dxx, 0.5 * dxy, 0.5 * dyx, 0.5 * dyy, 0.5 * touching, heat, couple),
            duration,
        )

    @_device
    def to_cells(runs, run, first, threads, strain, rate, turns):
        """Wrap the disks, remember their contacts, and put them into cells."""
        now, home, lists = runs.now[run], runs.home[run], _lists_of(runs, run)
        filled, members = runs.filled[run], runs.members[run]
        numbers, orders, n = runs.numbers[run], runs.orders[run], runs.R.shape[1]
        cell, columns, rows = _cell_of(numbers, strain, turns, rate), orders[COLUMNS], orders[ROWS]
        for c in range(first, columns * rows, threads):
            filled[c] = 0
        if first == 0:
            runs.built[run, 0] = runs.built[run, 1] = 0.0
            runs.built[run, 2] = turns
        for a in range(first, n, threads):
            x, y = now[5 * a], now[5 * a + 1]
            if not abs(x) + abs(y) < 1e15:
                runs.state[run, 0] = DIVERGED
                x = y = 0.0
            row = math.floor(y / cell.Ly)
            y -= row * cell.Ly
            x -= row * cell.slip
            x -= math.floor(x / cell.Lx) * cell.Lx
            now[5 * a], now[5 * a + 1], home[a], home[n + a] = x, y, x, y
            now[5 * a + 2] -= row * cell.slide
            if orders[GATHER] == 1:
                held = 0
                for c in range(lists.count[a]):
                    if (lists.bits[a] >> c) & 1:
                        runs.open[held, run, a] = lists.code[c * n + a] & MASK
                        runs.began[held, run, a] = lists.since[c * n + a]
                        held += 1
                runs.held[run, a] = held
        barrier()
        for a in range(first, n, threads):
            column = min(max(int(now[5 * a] / cell.Lx * columns), 0), columns - 1)
            there = min(max(int(now[5 * a + 1] / cell.Ly * rows), 0), rows - 1) * columns + column
            place = cuda.atomic.add(filled, there, 1)
            if place < members.shape[0]:
                members[place, there] = a
            else:
                runs.state[run, 0] = CROWDED
        barrier()

    @_device
    def list_neighbours(a, runs, run, cell):
        """List the neighbours of disk a by their gap, and mark those in contact."""
        now, R, lists, gap = runs.now[run], runs.R[run], _lists_of(runs, run), runs.gap[run]
        filled, members = runs.filled[run], runs.members[run]
        n, columns, rows = len(R), runs.orders[run, COLUMNS], runs.orders[run, ROWS]
        x, y, reach = now[5 * a], now[5 * a + 1], R[a] + runs.numbers[run, SKIN]
        home = min(max(int(y / cell.Ly * rows), 0), rows - 1)
        found = z = 0
        for row in range(home - 1, home + 2):
            up = row // rows
            column = math.floor((x - up * cell.slip) / cell.Lx * columns)
            for side in range(column - 1, column + 2):
                right = side // columns
                there = (row - up * rows) * columns + side - right * columns
                for k in range(min(filled[there], members.shape[0])):
                    j = members[k, there]
                    dx, dy = now[5 * j] - x + right * cell.Lx + up * cell.slip, now[5 * j + 1] - y + up * cell.Ly
                    if j == a or dx * dx + dy * dy > (reach + R[j]) ** 2:
                        continue
                    if found == PLACES:
                        runs.state[run, 0] = FULL
                        break
                    inverse = 1.0 / (R[a] + R[j])
                    ratio = (dx * dx + dy * dy) * inverse * inverse
                    z += 1 if ratio <= 1.0 else 0
                    code, key = j | ((8 * (up + 1) + right + 4) << IMAGES), float32(ratio)
                    place = found * n + a
                    while place >= n and (gap[place - n], lists.code[place - n]) > (key, code):
                        lists.code[place], lists.inverse[place] = lists.code[place - n], lists.inverse[place - n]
                        gap[place] = gap[place - n]
                        place -= n
                    lists.code[place], lists.inverse[place], gap[place] = code, inverse, key
                    found += 1
        bits = 0
        for k in range(runs.held[run, a]):
            c = 0
            while c < found and lists.code[c * n + a] & MASK != runs.open[k, run, a]:
                c += 1
            if c < found:
                bits |= 1 << c
                lists.since[c * n + a] = runs.began[k, run, a]
            elif found < PLACES and runs.state[run, 0] != CROWDED:
                runs.state[run, 0] = LOST
        lists.count[a], lists.bits[a], runs.z[run, a] = found, bits, z

    @_device
    def bounds(a, runs, run, law, cell):
        """Return the bounds of disk a for the eigenvalues of M⁻¹B and M⁻¹K (:func:`petscjam.md.contact.fastest`)."""
        now, z, lists, n = runs.now[run], runs.z[run], _lists_of(runs, run), runs.R.shape[1]
        s = cuda.local.array(9, float64)
        for k in range(9):
            s[k] = 0.0
        for c in range(lists.count[a]):
            code, inverse = lists.code[c * n + a], lists.inverse[c * n + a]
            x, y, _, _ = _separation(code, a, now, 0, cell)
            x *= inverse
            y *= inverse
            square = x * x + y * y
            if square <= 1.0 and z[a] > 0:
                w = 1.0 + z[code & MASK] / z[a]
                k = w * stiffness(math.sqrt(square), inverse, power, absolute, d2U)
                cos, sin = (x * x - y * y) / square, 2.0 * x * y / square
                s[0] += w
                s[1] += w * cos
                s[2] += w * sin
                s[3] += k
                s[4] += k * cos
                s[5] += k * sin
                s[6] += w * x
                s[7] += w * y
                s[8] += w * square
        most = largest(film_of(law))
        normal, tangential = law.normal * most, law.tangential * most
        return fastest(s, runs.m[run, a], runs.R[run, a], normal, tangential, law.rolls, law.body, law.drag)

    @_device
    def demand(relaxation, oscillation, dt):
        """Return the parts of a step that are needed for stability (:func:`petscjam.md.model.stable_step`)."""
        if heun:
            largest = min(2.0 / relaxation if relaxation > 0.0 else math.inf, math.inf)
            if oscillation > 0.0:
                largest = min(largest, math.sqrt(3.0 / oscillation))
        else:
            both = relaxation + math.sqrt(relaxation * relaxation + oscillation)
            largest = 2.0 / both if both > 0.0 else math.inf
        parts = 1
        while dt > parts * largest and parts <= TICKS:
            parts *= 2
        return parts

    @_device
    def build(runs, run, first, threads, law, strain, rate):
        """List the neighbours of all disks; return the whole cells of strain that are left out, and parts needed."""
        turns = math.floor(strain * runs.numbers[run, LY] / runs.numbers[run, LX] + 0.5)
        to_cells(runs, run, first, threads, strain, rate, turns)
        cell, n = _cell_of(runs.numbers[run], strain, turns, rate), runs.R.shape[1]
        for a in range(first, n, threads):
            list_neighbours(a, runs, run, cell)
        barrier()
        relaxation = oscillation = 0.0
        for a in range(first, n, threads):
            one, two = bounds(a, runs, run, law, cell)
            relaxation, oscillation = max(relaxation, one), max(oscillation, two)
        if relaxation > runs.built[run, 0]:
            cuda.atomic.max(runs.built, (run, 0), relaxation)
        if oscillation > runs.built[run, 1]:
            cuda.atomic.max(runs.built, (run, 1), oscillation)
        barrier()
        dt = runs.numbers[run, DT] * runs.orders[run, PARTS]
        return turns, demand(runs.built[run, 0], runs.built[run, 1], dt)

    @_device
    def jump(a, q, m, n, Ly, old, new, bulk):
        """Change the strain rate for disk a; return the change of its energy (:func:`petscjam.md.kernels.jump`)."""
        y, gain = q[n + a], 0.0
        x, v, w = q[2 * n + a] - old * y, q[3 * n + a], q[4 * n + a]
        gain -= m[a] * (0.5 * (x * x + v * v) + 0.25 * w * w)
        if bulk == 1:
            factor = new / old
            q[2 * n + a] *= factor
            q[3 * n + a] *= factor
            q[4 * n + a] *= factor
        elif bulk == 2:
            q[2 * n + a] += (new - old) * y
        else:
            q[2 * n + a] += (new - old) * Ly * math.floor(y / Ly)
        x, v, w = q[2 * n + a] - new * y, q[3 * n + a], q[4 * n + a]
        return gain + m[a] * (0.5 * (x * x + v * v) + 0.25 * w * w)

    @_device
    def add_up(runs, run, thread, names):
        """Add the sums of the threads of a block, in their order."""
        cuda.syncthreads()
        block, start = (cuda.blockIdx.x if wide else 0), thread - cuda.threadIdx.x
        for name in range(cuda.threadIdx.x, names, cuda.blockDim.x):
            total = 0.0
            for t in range(start, start + cuda.blockDim.x):
                total += runs.part[run, name, t]
            runs.sums[run, block, name] = total

    @kernel
    def advance(runs):
        """Make parts of steps."""
        run, first, threads = cuda.blockIdx.x, cuda.threadIdx.x, cuda.blockDim.x
        if wide:
            run, first, threads = 0, cuda.grid(1), cuda.gridsize(1)
        numbers, orders = runs.numbers[run], runs.orders[run]
        if orders[END] < 0:
            return
        strains, rates = runs.course[run, 0], runs.course[run, 1]
        s = runs.s[run] if wide else cuda.shared.array(0, float64)
        now, q, F, R, m, light, home, lists, angles = (
            runs.now[run],
            runs.q[run],
            runs.F[run],
            runs.R[run],
            runs.m[run],
            runs.light[run],
            runs.home[run],
            _lists_of(runs, run),
            runs.angles[run],
        )
        law = law_of(numbers)
        n, dt, parts, ticks = index(len(R)), numbers[DT], orders[PARTS], TICKS // orders[PARTS]
        exx = exy = eyy = dxx = dxy = dyx = dyy = touching = heat = kxx = kxy = kyy = work = jumps = 0.0
        duration = k = builds = turn = at = 0
        begun, end, needed, turns, built, old = -1, orders[END], parts, 0.0, strains[0], rates[0]
        stale, fresh, counted, status = True, True, orders[COUNTED] == 1, FINE
        while True:
            if stale:
                for i in range(first, n, threads):
                    a = index(i)
                    if builds > 0:
                        for x in range(5):
                            now[5 * a + x] = q[x * n + a]
                built = strains[k]
                turns, needed = build(runs, run, first, threads, law, built, old)
                for i in range(first, n, threads):
                    a = index(i)
                    for x in range(5):
                        q[x * n + a] = now[5 * a + x]
                builds += 1
                status = runs.state[run, 0]
                end = orders[END] if needed == parts else k + (orders[END] - k) % parts
                stale, fresh, begun = False, True, k
            if status != FINE or k >= end:
                break
            rate, tick = rates[k + 1], orders[TICK] + k * ticks
            changed, change = rate != old, rate - old
            cell = _cell_of(numbers, strains[k], turns, rate)
            if heun or fresh or changed:
                if wide:
                    at = 5 * n - at
                else:
                    barrier()
                for i in range(first, n, threads):
                    a = index(i)
                    if changed:
                        jumps += jump(a, q, m, n, cell.Ly, old, rate, orders[BULK])
                    for x in range(5):
                        s[at + 5 * a + x] = q[x * n + a]
                barrier()
                measure = changed or (heun and not counted)
                for i in range(first, n, threads):
                    a = index(i)
                    f, e, long = force(a, n, s, at, R, lists, law, cell, tick, measure, angles)
                    F[a], F[n + a], F[2 * n + a] = f
                    duration += long
                    if changed:
                        cx, cy = q[2 * n + a] - rate * q[n + a], q[3 * n + a]
                        work += (0.5 if heun else -0.5) * change * (e[1] + e[4] + m[a] * cx * cy)
                    if heun and measure:
                        exx, exy, eyy = exx + e[0], exy + e[1], eyy + e[2]
                        dxx, dxy, dyx, dyy = dxx + e[3], dxy + e[4], dyx + e[5], dyy + e[6]
                        touching, heat, work = touching + e[7], heat + e[8], work + e[9] - rate * (e[1] + e[4])
                old, fresh = rate, False
            cell = _cell_of(numbers, strains[k + 1], turns, rate)
            shear = strains[k + 1] - built
            room = numbers[SKIN] - numbers[REACH] * (math.sqrt(1.0 + 0.25 * shear * shear) + 0.5 * abs(shear) - 1.0)
            room = max(0.5 * room, 0.0)
            if wide:
                at = 5 * n - at
            else:
                barrier()
            half = 0.0 if heun else 0.5 * dt
            for i in range(first, n, threads):
                a = index(i)
                gain, u, v, fx, fy, p = dt * light[a], q[2 * n + a], q[3 * n + a], F[a], F[n + a], at + 5 * a
                x, y = q[a] + dt * u + half * gain * fx, q[n + a] + dt * v + half * gain * fy
                s[p], s[p + 1], s[p + 2], s[p + 3] = x, y, u + gain * fx, v + gain * fy
                s[p + 4] = q[4 * n + a] + gain * F[2 * n + a]
                if heun and not counted:
                    cx = u - rate * q[n + a]
                    kxx, kxy, kyy = kxx + m[a] * cx * cx, kxy + m[a] * cx * v, kyy + m[a] * v * v
                    work -= rate * m[a] * cx * v
                dx, dy = x - shear * y - home[a], y - home[n + a]
                if dx * dx + dy * dy > room * room:
                    runs.state[run, 1] = turn
            barrier()
            counted, turn = True, turn + 1
            if room == 0.0 or runs.state[run, 1] == turn - 1:
                if begun == k:
                    status = WIDEN
                    break
                stale = True
                continue
            for i in range(first, n, threads):
                a = index(i)
                f, e, long = force(a, n, s, at, R, lists, law, cell, tick, single, angles)
                h, p, before = 0.5 * dt * light[a], at + 5 * a, q[4 * n + a]
                if heun:
                    u, v = q[2 * n + a], q[3 * n + a]
                    u1, v1 = u + h * (F[a] + f[0]), v + h * (F[n + a] + f[1])
                    q[a] += 0.5 * dt * (u + u1)
                    q[n + a] += 0.5 * dt * (v + v1)
                    q[2 * n + a], q[3 * n + a] = u1, v1
                    q[4 * n + a] = before + h * (F[2 * n + a] + f[2])
                else:
                    duration += long
                    x, y, u, v, w = s[p], s[p + 1], s[p + 2], s[p + 3], s[p + 4]
                    q[a], q[n + a], q[2 * n + a] = x, y, 0.5 * (q[2 * n + a] + u) + h * f[0]
                    q[3 * n + a] = 0.5 * (q[3 * n + a] + v) + h * f[1]
                    q[4 * n + a] = 0.5 * (before + w) + h * f[2]
                    F[a], F[n + a], F[2 * n + a] = f
                    cx, mass = u - rate * y, m[a]
                    exx, exy, eyy = exx + e[0], exy + e[1], eyy + e[2]
                    dxx, dxy, dyx, dyy = dxx + e[3], dxy + e[4], dyx + e[5], dyy + e[6]
                    kxx, kxy, kyy = kxx + mass * cx * cx, kxy + mass * cx * v, kyy + mass * v * v
                    touching, heat = touching + e[7], heat + e[8]
                    work += e[9] - rate * (e[1] + e[4] + mass * cx * v)
                if orders[TURNS] == 1:
                    runs.angle[run, a] += 0.5 * dt * (before + q[4 * n + a]) / R[a]
            k, counted = k + 1, False
        for i in range(first, n, threads):
            a = index(i)
            for x in range(5):
                now[5 * a + x] = q[x * n + a]
        part = runs.part[run]
        part[EXX, first], part[EXY, first], part[EYY, first] = exx, exy, eyy
        part[DXX, first], part[DXY, first], part[DYX, first], part[DYY, first] = dxx, dxy, dyx, dyy
        part[TOUCHING, first], part[HEAT, first] = touching, heat
        part[KXX, first], part[KXY, first], part[KYY, first] = kxx, kxy, kyy
        part[WORK, first], part[JUMPS, first] = work, jumps
        if duration != 0:
            cuda.atomic.add(runs.duration, (run, 0), duration)
        add_up(runs, run, first, SUMS)
        if first == 0:
            done = runs.done[run]
            done[MADE], done[BUILDS], done[BEGUN], done[DEMAND], done[STATUS] = k, builds, begun, needed, status
            done[CHANGED], done[HALFWAY] = (1 if old != rates[k] else 0), (1 if counted else 0)

    @kernel
    def look(runs):
        """Sum what a sample, the energy and, with END = 1, the trapezoidal rule need of the current state."""
        run, first, threads = cuda.blockIdx.x, cuda.threadIdx.x, cuda.blockDim.x
        if wide:
            run, first, threads = 0, cuda.grid(1), cuda.gridsize(1)
        numbers, orders, part = runs.numbers[run], runs.orders[run], runs.part[run]
        if orders[END] < 0:
            return
        now, R, m, lists, rate = runs.now[run], runs.R[run], runs.m[run], _lists_of(runs, run), runs.course[run, 1, 0]
        law = law_of(numbers)
        cell, tick = _cell_of(numbers, runs.course[run, 0, 0], runs.built[run, 2], rate), orders[TICK]
        stress, n = runs.stress[run], index(len(R))
        sums, v, least = cuda.local.array(LOOKED, float64), cuda.local.array(4, float64), NONE
        for k in range(LOOKED):
            sums[k] = 0.0
        for i in range(first, n, threads):
            a = index(i)
            pxx = pxy = pyy = 0.0
            for c in range(lists.count[a]):
                code, inverse = lists.code[c * n + a], lists.inverse[c * n + a]
                j, touched = code & MASK, (lists.bits[a] >> c) & 1 == 1
                x, y, ux, uy = _separation(code, a, now, 0, cell)
                r = math.sqrt(x * x + y * y)
                if touched:
                    turn = law.rolls * (now[5 * a + 4] + now[5 * j + 4]) * inverse
                    wx, wy, near = ux + turn * y, uy - turn * x, 1.0 / r
                    spring, gx, gy, _ = contact(
                        x, y, wx, wy, near, inverse, law.normal, law.tangential, film_of(law), exponent, absolute, dU
                    )
                    pxx, pxy = pxx + (spring * x - gx) * x, pxy + (spring * x - gx) * y
                    pyy += (spring * y - gy) * y
                if a > j:
                    continue
                if r * inverse < 1.0:
                    sums[ELASTIC] += energy(1.0 - r * inverse, inverse, power, absolute, U)
                if touched:
                    v[0] = (ux * y - uy * x) / r
                    v[1] = (now[5 * a + 4] + now[5 * j + 4]) * r * inverse
                    v[2] = v[0] + v[1]
                    v[3] = -(ux * x + uy * y) / r
                    sums[SQUARES] += v[3] * v[3]
                    sums[SQUARES_T] += v[0] * v[0]
                    sums[NUMBER] += 1.0
                    if rate != 0.0:
                        place = SECOND
                        for k in range(4):
                            v[k] /= rate
                            sums[FIRST + k] += v[k]
                            for i in range(k + 1):
                                sums[place] += v[k] * v[i]
                                place += 1
                        key = (a * 7919 + j * 104729 + tick // TICKS % 1048576 * 1299709) % 2147483647
                        key = key * 48271 % 2147483647 * 48271 % 2147483647 * 2147483648 + 64 * a + c
                        if key < least:
                            least = key
                            for k in range(4):
                                sums[ONE + k] = v[k]
            stress[a], stress[n + a], stress[2 * n + a] = 0.5 * pxx, 0.5 * pxy, 0.5 * pyy
            sums[ROTATIONAL] += 0.25 * m[a] * now[5 * a + 4] ** 2
            cx, cy = now[5 * a + 2] - rate * now[5 * a + 1], now[5 * a + 3]
            sums[KXX] += m[a] * cx * cx
            sums[KXY] += m[a] * cx * cy
            sums[KYY] += m[a] * cy * cy
            if orders[END] == 1:
                _, e, long = force(a, n, now, 0, R, lists, law, cell, tick, True, runs.angles[run])
                for k in range(HEAT + 1):
                    sums[k] += e[k]
                sums[WORK] += e[9] - rate * (e[1] + e[4] + m[a] * cx * cy)
                if long != 0:
                    cuda.atomic.add(runs.duration, (run, 0), long)
        for k in range(LOOKED):
            part[k, first] = sums[k]
        runs.key[run, first] = least
        add_up(runs, run, first, ONE)
        if cuda.threadIdx.x == 0:
            block, best = (cuda.blockIdx.x if wide else 0), first
            for t in range(first, first + cuda.blockDim.x):
                if runs.key[run, t] < runs.key[run, best]:
                    best = t
            runs.keys[run, block] = runs.key[run, best]
            for k in range(4):
                runs.sums[run, block, ONE + k] = part[ONE + k, best]

    return advance, look
