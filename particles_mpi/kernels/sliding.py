"""Velocities under a friction of constant magnitude, b against the velocity, and a constant acceleration. Arrays only."""

from math import exp, expm1, inf, log1p, sqrt

from particles_mpi.kernels.jit import lean, lean_inner

NEAR_STANDSTILL = 8.0  # times what force and friction do in a step: a standstill
MOST_ROUNDS = 100
LARGEST_Y = 1e20  # of y in `slide`: (steep - 1) y is below 50 and steep - 1, if not 0, above 1e-16


@lean_inner
def slowed(speed: float, loss: float) -> float:
    """Factor on a velocity of magnitude `speed` after friction took `loss` = alpha h/m of it: max(0, 1 - loss/speed)."""
    return 1.0 - loss / speed if loss < speed else 0.0


@lean_inner
def sliding_time(y, steep, away2):
    """(t, dt/dy): the time in which tan(phi/2) falls by the factor e^-y, in units of |v_0|/(|a| (1 + u_0^2)); see `slide`.

    steep: mu = b/|a|; away2: u_0^2.
    """
    slower, faster = 1.0 - steep, 1.0 + steep
    along = expm1(slower * y) / slower if slower != 0.0 else y
    return along - away2 * expm1(-faster * y) / faster, exp(slower * y) + away2 * exp(-faster * y)


@lean_inner
def stops(v, a, i, b, decay, h):
    """Does dv/dt = a - b v/|v| bring row i to rest within h, if it begins at v times `decay`? Then it stays, since b > |a|.

    b |v| + v.a falls at the rate b^2 - a^2, so that 0 is reached at the time (b |v| + v.a)/(b^2 - a^2).
    """
    a2, speed2, along = 0.0, 0.0, 0.0
    for k in range(v.shape[1]):
        a2 += a[i, k] ** 2
        speed2 += v[i, k] ** 2
        along += v[i, k] * a[i, k]
    return b * b > a2 and decay * (b * sqrt(speed2) + along) <= (b * b - a2) * h


@lean_inner
def slide(v, a, i, pull, b, decay, h):
    """dv/dt = a - b v/|v| with |a| = `pull`, exactly over h, between two halves of drag, each a factor `decay`. In place.

    For friction that does not bring the row to rest within h, see `stops`.

    Along a the problem has one dimension. Else let phi be the angle between v and a, u = tan(phi/2), mu = b/|a|: from
    d|v|/dt = |a| cos(phi) - b and |v| dphi/dt = -|a| sin(phi) follows |v| = C u^(mu-1) (1 + u^2), and with y = ln(u_0/u)
    t = |v_0|/(|a| (1 + u_0^2)) ((e^((1-mu) y) - 1)/(1 - mu) + u_0^2 (1 - e^(-(1+mu) y))/(1 + mu)), which Newton's method solves.
    """
    along, speed2 = 0.0, 0.0
    for k in range(v.shape[1]):
        v[i, k] *= decay
        along += v[i, k] * a[i, k] / pull
        speed2 += v[i, k] ** 2
    across2 = 0.0
    for k in range(v.shape[1]):
        across2 += (v[i, k] - along * a[i, k] / pull) ** 2
    across, speed = sqrt(across2), sqrt(speed2)
    fraction = 0.0  # of the velocity across a that is left
    if across <= 1e-9 * speed:
        turns = -along / (pull + b)  # the time at which it moves along a
        if along >= 0.0:
            after = along + (pull - b) * h
        else:
            after = along + (pull + b) * h if turns > h else (pull - b) * (h - turns)
    else:
        u = across / (speed + along) if along >= 0.0 else (speed - along) / across
        steep, unit = b / pull, pull * (1.0 + u * u) / speed
        if steep < 1.0:
            y = log1p(h * unit) / (1.0 - steep)  # too long: the first part alone takes more than h
        else:
            y = 1.0
            while y < LARGEST_Y and sliding_time(y, steep, u * u)[0] < h * unit:
                y *= 2.0
        low, high = 0.0, y
        for _ in range(MOST_ROUNDS):
            time, rate = sliding_time(y, steep, u * u)
            late = time - h * unit
            low, high = (low, y) if late > 0.0 else (y, high)
            step = y - late / rate if rate > 0.0 else low  # far out it is below the range of numbers
            step = step if low < step < high else 0.5 * (low + high)
            if abs(step - y) <= 1e-15 * high:
                break
            y = step
        fraction = exp(-steep * y)
        u_after = u * exp(-y)
        after = speed * exp((1.0 - steep) * y) * (1.0 - u_after) * (1.0 + u_after) / (1.0 + u * u)
    for k in range(v.shape[1]):
        v[i, k] = decay * ((v[i, k] - along * a[i, k] / pull) * fraction + after * a[i, k] / pull)


@lean
def kick_with_friction(v, a, mass, decay, force_time, strength, h, coast):
    """friction(h/2) . force(h) . friction(h/2), in place on v (n, d); what friction brings to rest stays at rest.

    mass, decay, force_time (n,): by drag and force v becomes decay v + force_time a over h; strength: alpha, a force. The
    factors of half a step are exact, their composition is of second order.

    A free particle that will stop within the coming drift of length `coast` = dt, i.e. |v| <= alpha dt/m, is given its
    mean velocity over that drift, v t/(2 dt) with t = m |v|/alpha: it covers exactly its stopping distance m v^2/(2 alpha),
    and the closing half-step then brings it to rest. Near a standstill, where the direction of the friction turns within the
    step, it is brought to rest or not as `stops` says, and else moved by `slide`.
    """
    d = v.shape[1]
    for i in range(v.shape[0]):
        loss = strength * h / mass[i]
        before = 0.0
        for k in range(d):
            before += v[i, k] ** 2
        before = sqrt(before)
        if coast > 0.0 and before * mass[i] <= strength * coast:
            mean = 0.5 * before * mass[i] / (strength * coast) if before > 0.0 else 0.0
            for k in range(d):
                v[i, k] *= mean
            continue
        a2 = 0.0
        for k in range(d):
            a2 += a[i, k] ** 2
        if loss > 0.0 and a2 * h * h < inf and before < NEAR_STANDSTILL * (sqrt(a2) * h + loss):
            if stops(v, a, i, loss / h, sqrt(decay[i]), h):
                for k in range(d):
                    v[i, k] = 0.0
                continue
            if a2 > 0.0:
                slide(v, a, i, sqrt(a2), loss / h, sqrt(decay[i]), h)
                continue
        first = slowed(before, 0.5 * loss)
        after = 0.0
        for k in range(d):
            v[i, k] = v[i, k] * first * decay[i] + a[i, k] * force_time[i]
            after += v[i, k] ** 2
        second = slowed(sqrt(after), 0.5 * loss)
        for k in range(d):
            v[i, k] *= second
