"""Where a light is, from the directions and fluxes in which several cameras see it: one model for near and far.

Unknowns about the rig's centre C: direction u, inverse distance rho, and s = ln F, the flux as irradiance at C. From a camera at K the
light lies along p = u + rho (C - K), and ln F_K = s - 2 ln |p|. All is smooth through rho = 0, a light at infinity. Least squares by
Gauss-Newton steps with damping (Levenberg 1944, Marquardt 1963); the place is C + u / rho (inverse depth: Civera, Davison and Montiel
2008, eq. 3).
"""

import numpy as np

from vemlight.kernels import kernel, subroutine

FLUX_SIGMA = 0.12  # of ln flux: lamps do not shine alike to all sides
UNKNOWN_FLUX = 0.25  # variance of ln flux from which on it, and a colour, are those of saturated pixels
ROUNDS = 12  # of a fit: three to five are the rule
ENOUGH = 1e-3  # by which chi2 must fall for another round: far below the gates of matching.py
MAX_RHO, MIN_RHO = 8.0, -1.0  # 1/m: a light 12 cm from the centre; what noise makes of a far one
STARTS = (0.0, 0.2, 0.5, 1.2)  # 1/m
GOOD = 6.0  # chi2 over the degrees of freedom, above which the next start is tried
PARAMETERS = 4  # u in two, rho, s
FIT = 44  # numbers of a fit: see `fit_light`
WORK = 26  # rows of what a fit computes with: three matrices, and vectors from row 16 on


@subroutine
def set_basis(u, e1, e2):
    # two unit vectors across u (Duff et al. 2017)
    sign = 1.0 if u[2] >= 0 else -1.0
    a = -1.0 / (sign + u[2])
    b = u[0] * u[1] * a
    e1[0], e1[1], e1[2] = 1 + sign * u[0] * u[0] * a, sign * b, -sign * u[0]
    e2[0], e2[1], e2[2] = b, sign + u[1] * u[1] * a, -u[1]


@subroutine
def solve(matrix, right, size):
    # matrix x = right for a positive definite matrix, both overwritten (Cholesky); False where it is not
    for i in range(size):
        for j in range(i + 1):
            total = matrix[i, j]
            for k in range(j):
                total -= matrix[i, k] * matrix[j, k]
            if i == j:
                if not total > 1e-300:
                    return False
                matrix[i, i] = np.sqrt(total)
            else:
                matrix[i, j] = total / matrix[j, j]
    for i in range(size):
        for k in range(i):
            right[i] -= matrix[i, k] * right[k]
        right[i] /= matrix[i, i]
    for i in range(size - 1, -1, -1):
        for k in range(i + 1, size):
            right[i] -= matrix[k, i] * right[k]
        right[i] /= matrix[i, i]
    return True


@subroutine
def _terms(seen, sources, offsets, pose, u, e1, e2, rho, s, normal, right, random):
    # chi2, J^T W J and J^T W r; and, where `random` has rows, J^T W R W J of the part R of the variances that is new each frame. A place is
    # off in the two directions across a source's d; with d d^T + t1 t1^T + t2 t2^T = 1 their derivatives need no t1 and t2.
    chi2, all_terms = 0.0, len(random) > 0
    for i in range(PARAMETERS):
        right[i] = 0.0
        for j in range(i + 1):
            normal[i, j] = 0.0
            if all_terms:
                random[i, j] = 0.0
    for k in range(len(sources)):
        n = sources[k]
        if n < 0:
            continue
        qx, qy, qz = offsets[k, 0], offsets[k, 1], offsets[k, 2]
        px, py, pz = u[0] + rho * qx, u[1] + rho * qy, u[2] + rho * qz
        length = np.sqrt(px * px + py * py + pz * pz)
        if not length > 1e-3:
            return np.inf
        px, py, pz = px / length, py / length, pz / length
        dx, dy, dz = seen[k, n, 0], seen[k, n, 1], seen[k, n, 2]
        along = dx * px + dy * py + dz * pz
        if along < 0:  # what lies on the other side is no solution
            return np.inf
        place = pose[1] * rho / length
        weight = 1 / (seen[k, n, 4] + seen[k, n, 5] + pose[0] * pose[0] + place * place)
        x, y, z = dy * pz - dz * py, dz * px - dx * pz, dx * py - dy * px
        chi2 += weight * (x * x + y * y + z * z)
        residual, flux_weight = s - 2 * np.log(length) - seen[k, n, 3], 1 / seen[k, n, 6]
        chi2 += flux_weight * residual * residual

        # of e1, e2 and q: what of them lies along the light, and what they turn it towards the source
        a1 = e1[0] * px + e1[1] * py + e1[2] * pz
        a2 = e2[0] * px + e2[1] * py + e2[2] * pz
        a3 = qx * px + qy * py + qz * pz
        v1 = e1[0] * dx + e1[1] * dy + e1[2] * dz - along * a1
        v2 = e2[0] * dx + e2[1] * dy + e2[2] * dz - along * a2
        v3 = qx * dx + qy * dy + qz * dz - along * a3
        q1, q2 = e1[0] * qx + e1[1] * qy + e1[2] * qz, e2[0] * qx + e2[1] * qy + e2[2] * qz
        qq = qx * qx + qy * qy + qz * qz
        turned, fluxed = weight * along / length, 2 * flux_weight * residual / length
        right[0] += turned * v1 + fluxed * a1
        right[1] += turned * v2 + fluxed * a2
        right[2] += turned * v3 + fluxed * a3
        right[3] -= flux_weight * residual
        _add_products(normal, weight, flux_weight, length, a1, a2, a3, v1, v2, v3, q1, q2, qq)
        if all_terms:
            of_frame, flux_of_frame = weight * weight * seen[k, n, 4], flux_weight * flux_weight * seen[k, n, 7]
            _add_products(random, of_frame, flux_of_frame, length, a1, a2, a3, v1, v2, v3, q1, q2, qq)
    return chi2


@subroutine
def _add_products(matrix, weight, flux_weight, length, a1, a2, a3, v1, v2, v3, q1, q2, qq):
    # the lower triangle of a camera's J^T W J, as `_terms` has its parts
    across, flux = weight / (length * length), 4 * flux_weight / (length * length)
    matrix[0, 0] += across * (1 - a1 * a1 - v1 * v1) + flux * a1 * a1
    matrix[1, 0] += across * (-a1 * a2 - v1 * v2) + flux * a1 * a2
    matrix[1, 1] += across * (1 - a2 * a2 - v2 * v2) + flux * a2 * a2
    matrix[2, 0] += across * (q1 - a1 * a3 - v1 * v3) + flux * a1 * a3
    matrix[2, 1] += across * (q2 - a2 * a3 - v2 * v3) + flux * a2 * a3
    matrix[2, 2] += across * (qq - a3 * a3 - v3 * v3) + flux * a3 * a3
    scale = -2 * flux_weight / length
    matrix[3, 0] += scale * a1
    matrix[3, 1] += scale * a2
    matrix[3, 2] += scale * a3
    matrix[3, 3] += flux_weight


@subroutine
def _descend(seen, sources, offsets, pose, start, fit, work):
    # from a direction, work[20], which is changed, and an inverse distance; returns chi2 and fills rho, s
    normal, new_normal, damped, none = work[:4], work[4:8], work[8:12], work[:0]
    right, new_right, step, u, new_u = work[16], work[17], work[18], work[20], work[21]
    e1, e2, new_e1, new_e2 = work[22], work[23], work[24], work[25]
    rho, s, count = start, 0.0, 0
    for k in range(len(sources)):
        if sources[k] >= 0:
            p = 0.0
            for x in range(3):
                p += (u[x] + rho * offsets[k, x]) ** 2
            s += seen[k, sources[k], 3] + np.log(max(p, 1e-6))
            count += 1
    s /= count
    damping = 1e-3
    set_basis(u, e1, e2)
    chi2 = _terms(seen, sources, offsets, pose, u, e1, e2, rho, s, normal, right, none)
    for _ in range(ROUNDS):
        if not chi2 < np.inf:
            break
        for i in range(PARAMETERS):
            for j in range(i + 1):
                damped[i, j] = normal[i, j]
            damped[i, i] *= 1 + damping
            step[i] = right[i]
        damped[2, 2] += 1e-3  # a light on the line through both cameras has no parallax
        if not solve(damped, step, PARAMETERS):
            break
        length = 0.0
        for x in range(3):
            new_u[x] = u[x] + e1[x] * step[0] + e2[x] * step[1]
            length += new_u[x] * new_u[x]
        length = np.sqrt(length)
        for x in range(3):
            new_u[x] /= length
        new_rho, new_s = min(max(rho + step[2], MIN_RHO), MAX_RHO), s + step[3]
        set_basis(new_u, new_e1, new_e2)
        new = _terms(seen, sources, offsets, pose, new_u, new_e1, new_e2, new_rho, new_s, new_normal, new_right, none)
        if new < chi2:
            fell = chi2 - new
            rho, s, chi2, damping = new_rho, new_s, new, damping * 0.1
            u, new_u, e1, new_e1, e2, new_e2 = new_u, u, new_e1, e1, new_e2, e2
            normal, new_normal, right, new_right = new_normal, normal, new_right, right
            if fell < ENOUGH:
                break
        else:
            damping = max(damping * 10, 1e-3)
            if damping > 1e4:
                break
    for x in range(3):
        work[20, x] = u[x]
    fit[3], fit[4] = rho, s
    return chi2


@subroutine
def fit_light(seen, sources, offsets, pose, fit, work):
    """Fits one light; fit (FIT,) is filled: u (3), rho, s, chi2, covariance (4 x 4), its part that is new each frame (4 x 4), e1, e2.

    seen: (cameras, sources, 8) of each: direction in the world (3), ln flux, variance of the direction new each frame and fixed, variance
    of ln flux, its part that is new each frame. sources: (cameras,), the source of each, -1: none. offsets: (cameras, 3), C - K. pose:
    turn in rad and place in m, standard deviations. work: (WORK, 4), room for what is computed.
    """
    u, best, count = work[20], np.inf, 0
    for k in range(len(sources)):
        if sources[k] >= 0:
            count += 1
    dof = 3 * count - PARAMETERS
    start = _start(seen, sources, offsets)
    for n in range(-1, len(STARTS)):
        if n >= 0:
            start = STARTS[n]
        for x in range(3):
            u[x] = 0.0
            for k in range(len(sources)):
                if sources[k] >= 0:
                    u[x] += seen[k, sources[k], x] - min(start, 1.0) * offsets[k, x]
        length = np.sqrt(u[0] * u[0] + u[1] * u[1] + u[2] * u[2])
        if not length > 1e-6:
            continue
        for x in range(3):
            u[x] /= length
        rho, s = fit[3], fit[4]
        chi2 = _descend(seen, sources, offsets, pose, start, fit, work)
        if chi2 < best:
            best = chi2
            for x in range(3):
                fit[x] = u[x]
        else:
            fit[3], fit[4] = rho, s
        if best < GOOD * dof:
            break
    fit[5] = best
    return best


@subroutine
def _start(seen, sources, offsets):
    """The inverse distance by the rays' common point, linear in it, from the first camera that sees the light; 0 without parallax."""
    first = -1
    above, below, lead = 0.0, 0.0, 0.0
    for k in range(len(sources)):
        if sources[k] < 0:
            continue
        if first < 0:
            first = k
            continue
        a, b = seen[first, sources[first]], seen[k, sources[k]]
        dx, dy, dz = offsets[k, 0] - offsets[first, 0], offsets[k, 1] - offsets[first, 1], offsets[k, 2] - offsets[first, 2]
        cx, cy, cz = b[1] * dz - b[2] * dy, b[2] * dx - b[0] * dz, b[0] * dy - b[1] * dx
        ax, ay, az = b[1] * a[2] - b[2] * a[1], b[2] * a[0] - b[0] * a[2], b[0] * a[1] - b[1] * a[0]
        above -= ax * cx + ay * cy + az * cz
        below += cx * cx + cy * cy + cz * cz
    if not below > 1e-6:
        return 0.0
    rho = above / below
    for x in range(3):
        lead += (seen[first, sources[first], x] - rho * offsets[first, x]) ** 2
    return min(max(rho / np.sqrt(max(lead, 1e-6)), 0.0), MAX_RHO)


@subroutine
def add_covariance(seen, sources, offsets, pose, fit, work):
    """Fills the covariances, of all errors and of those that are new each frame, and the basis of a fit; 1e6 where nothing is known."""
    normal, inverse, random = work[:4], work[4:8], work[8:12]
    right, column, u, e1, e2 = work[16], work[17], work[20], work[22], work[23]
    for x in range(3):
        u[x] = fit[x]
    set_basis(u, e1, e2)
    _terms(seen, sources, offsets, pose, u, e1, e2, fit[3], fit[4], normal, right, random)
    for c in range(PARAMETERS):
        for i in range(PARAMETERS):
            for j in range(i + 1):
                inverse[i, j] = normal[i, j]
            inverse[i, i] += 1e-6
            column[i] = 1.0 if i == c else 0.0
        if not solve(inverse, column, PARAMETERS):
            for i in range(PARAMETERS):
                column[i] = 1e6 if i == c else 0.0
        for i in range(PARAMETERS):
            fit[6 + 4 * c + i] = column[i]
    for a in range(PARAMETERS):
        for b in range(PARAMETERS):
            total = 0.0
            for i in range(PARAMETERS):
                for j in range(PARAMETERS):
                    total += fit[6 + 4 * a + i] * (random[i, j] if j <= i else random[j, i]) * fit[6 + 4 * b + j]
            fit[22 + 4 * a + b] = total
    for x in range(3):
        fit[38 + x], fit[41 + x] = e1[x], e2[x]


@kernel
def fits(seen, chosen, offsets, pose):
    """`fit_light` and `add_covariance` of each row of chosen (n, cameras) int64: (n, FIT)."""
    table, work = np.zeros((len(chosen), FIT)), np.zeros((WORK, 4))
    for n in range(len(chosen)):
        fit_light(seen, chosen[n], offsets, pose, table[n], work)
        add_covariance(seen, chosen[n], offsets, pose, table[n], work)
    return table


def places(fit: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """The places (n, 3) m of fits (n, FIT) that are not at infinity."""
    return centre + fit[:, :3] / fit[:, 3:4]
