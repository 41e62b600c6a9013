"""Box-constrained quadratic programs of a few variables: projected Newton (Tassa, Mansard and Todorov 2014).

    minimise  1/2 x' H x + g' x    subject to  low <= x <= high

Bounds hold the variables whose gradient pushes outwards; the others take a Newton step, cut back to the box until
the value falls enough (Armijo). For the two or three controls of a stage that ends after one to three factorisations.
"""

import math

from optim.numerics.kernel import kernel

FREE, AT_LOW, AT_HIGH = 0, -1, 1
_ARMIJO = 0.1  # least share of the decrease that the slope promises
_MOST = 50  # iterations; three are usual, this is against cycling by rounding


@kernel
def factor(h, held, chol, size):
    """Cholesky factor of H with the rows and columns of held variables replaced by the identity's; False unless > 0.

    Its diagonal holds the reciprocals: divisions are slow.
    """
    m = len(size)
    for i in range(m):
        for j in range(i + 1):
            if held[i] != 0 or held[j] != 0:
                total = 1.0 if i == j else 0.0
            else:
                total = h[i, j]
            for k in range(j):
                total -= chol[i, k] * chol[j, k]
            if i == j:
                if not total > 1e-12 * abs(h[i, i]):
                    return False
                chol[i, i] = 1.0 / math.sqrt(total)
            else:
                chol[i, j] = total * chol[j, j]
    return True


@kernel
def solve_factored(chol, b, size):
    """Overwrite b with the solution of (L L') x = b."""
    m = len(size)
    for i in range(m):
        for j in range(i):
            b[i] -= chol[i, j] * b[j]
        b[i] *= chol[i, i]
    for i in range(m - 1, -1, -1):
        for j in range(i + 1, m):
            b[i] -= chol[j, i] * b[j]
        b[i] *= chol[i, i]


@kernel
def _value(h, g, x, size):
    total = 0.0
    for i in range(len(size)):
        row = g[i]
        for j in range(len(size)):
            row += 0.5 * h[i, j] * x[j]
        total += row * x[i]
    return total


@kernel
def box_qp(h, g, low, high, x, held, chol, gradient, step, trial, size):
    """Solve from x, which is overwritten; False when H is not positive on the free variables.

    The arrays come one by one: in tuples each of them is counted as referenced at every call, by atomic operations that
    make a backward pass 7 % slower.

    Args:
        h, g: shapes (m, m) and (m,).
        low, high: shape (m,), low <= high.
        x: the first guess, then the solution. Shape (m,).
        held: which bound holds each variable at the solution: FREE, AT_LOW or AT_HIGH. Shape (m,).
        chol: the factor of H of the free variables, identity for the others. Shape (m, m).
        gradient, step, trial: work space. Shape (m,).
        size: any tuple of m entries: its length is known to the compiler, so that loops unroll (twice as fast).
    """
    m = len(size)
    for i in range(m):
        x[i] = min(max(x[i], low[i]), high[i])
    for iteration in range(_MOST):
        changed, slope = iteration == 0, 0.0
        for i in range(m):
            gradient[i] = g[i]
            for j in range(m):
                gradient[i] += h[i, j] * x[j]
            state = FREE
            if x[i] <= low[i] and (gradient[i] > 0.0 or high[i] <= low[i]):
                state = AT_LOW
            elif x[i] >= high[i] and gradient[i] < 0.0:
                state = AT_HIGH
            changed = changed or state != held[i]
            held[i] = state
            step[i] = -gradient[i] if state == FREE else 0.0
        if changed and not factor(h, held, chol, size):
            return False
        solve_factored(chol, step, size)
        inside, all_free = True, True
        for i in range(m):
            slope += gradient[i] * step[i]
            inside = inside and low[i] < x[i] + step[i] < high[i]
            all_free = all_free and held[i] == FREE
        if inside and all_free:  # Newton's step to the minimum of a quadratic
            for i in range(m):
                x[i] += step[i]
            return True
        before = _value(h, g, x, size)
        if -slope <= 1e-15 * abs(before):
            return True
        share, moved = 1.0, False
        while share > 1e-8 and not moved:
            drop = 0.0
            for i in range(m):
                trial[i] = min(max(x[i] + share * step[i], low[i]), high[i])
                drop += gradient[i] * (trial[i] - x[i])
            moved = _value(h, g, trial, size) <= before + _ARMIJO * drop
            share *= 0.5
        if not moved:
            return True
        for i in range(m):
            x[i] = trial[i]
    return True
