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
    # chi2; and, where `right` has a place, J^T W J, J^T W r and, of the part of the variance that is new each frame, J^T W R W J
    chi2 = 0.0
    wanted = len(right) == PARAMETERS
    if wanted:
        normal[:], right[:], random[:] = 0.0, 0.0, 0.0
    p, t1, t2 = np.empty(3), np.empty(3), np.empty(3)
    row = np.empty(PARAMETERS)
    for k in range(len(sources)):
        if sources[k] < 0:
            continue
        light, q = seen[k, sources[k]], offsets[k]
        for x in range(3):
            p[x] = u[x] + rho * q[x]
        length = np.sqrt(p[0] * p[0] + p[1] * p[1] + p[2] * p[2])
        if not length > 1e-3:
            return np.inf
        place = pose[1] * rho / length
        variance = light[4] + light[5] + pose[0] * pose[0] + place * place
        set_basis(light, t1, t2)
        for part in range(3):
            if part < 2:
                t = t1 if part == 0 else t2
                along = (t[0] * p[0] + t[1] * p[1] + t[2] * p[2]) / length
                residual, of_frame = along, light[4]
                for c in range(3):
                    d = e1 if c == 0 else e2 if c == 1 else q
                    ahead = (d[0] * p[0] + d[1] * p[1] + d[2] * p[2]) / (length * length)
                    row[c] = (t[0] * d[0] + t[1] * d[1] + t[2] * d[2]) / length - along * ahead
                row[3] = 0.0
                weight = 1 / variance
            else:
                residual, of_frame = s - 2 * np.log(length) - light[3], light[7]
                for c in range(3):
                    d = e1 if c == 0 else e2 if c == 1 else q
                    row[c] = -2 * (d[0] * p[0] + d[1] * p[1] + d[2] * p[2]) / (length * length)
                row[3] = 1.0
                weight = 1 / light[6]
            chi2 += weight * residual * residual
            if wanted:
                for i in range(PARAMETERS):
                    right[i] -= weight * row[i] * residual
                    for j in range(i + 1):
                        normal[i, j] += weight * row[i] * row[j]
                        random[i, j] += weight * weight * of_frame * row[i] * row[j]
        # the two tangents see behind themselves no light: what lies on the other side is no solution
        if light[0] * p[0] + light[1] * p[1] + light[2] * p[2] < 0:
            return np.inf
    return chi2


@subroutine
def _descend(seen, sources, offsets, pose, u, start, fit, work):
    # from a direction u, which is changed, and an inverse distance; returns chi2 and fills rho, s
    normal, damped, random = work[:4], work[4:8], work[8:12]
    right, none, e1, e2, tried = np.empty(4), np.empty(0), np.empty(3), np.empty(3), np.empty(3)
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
    chi2 = _terms(seen, sources, offsets, pose, u, e1, e2, rho, s, normal, right, random)
    for _ in range(ROUNDS):
        if not chi2 < np.inf:
            break
        for i in range(PARAMETERS):
            for j in range(i + 1):
                damped[i, j] = normal[i, j]
            damped[i, i] *= 1 + damping
        damped[2, 2] += 1e-3  # a light on the line through both cameras has no parallax
        if not solve(damped, right, PARAMETERS):
            break
        length = 0.0
        for x in range(3):
            tried[x] = u[x] + e1[x] * right[0] + e2[x] * right[1]
            length += tried[x] * tried[x]
        length = np.sqrt(length)
        for x in range(3):
            tried[x] /= length
        new_rho, new_s = min(max(rho + right[2], MIN_RHO), MAX_RHO), s + right[3]
        new = _terms(seen, sources, offsets, pose, tried, e1, e2, new_rho, new_s, normal, none, random)
        if new < chi2:
            fell = chi2 - new
            for x in range(3):
                u[x] = tried[x]
            rho, s, damping = new_rho, new_s, damping * 0.1
            set_basis(u, e1, e2)
            chi2 = _terms(seen, sources, offsets, pose, u, e1, e2, rho, s, normal, right, random)
            if fell < ENOUGH:
                break
        else:
            damping = max(damping * 10, 1e-3)
            if damping > 1e4:
                break
            _terms(seen, sources, offsets, pose, u, e1, e2, rho, s, normal, right, random)
    fit[3], fit[4] = rho, s
    return chi2


@subroutine
def fit_light(seen, sources, offsets, pose, fit, work):
    """Fits one light; fit (FIT,) is filled: u (3), rho, s, chi2, covariance (4 x 4), its part that is new each frame (4 x 4), e1, e2.

    seen: (cameras, sources, 8) of each: direction in the world (3), ln flux, variance of the direction new each frame and fixed, variance
    of ln flux, its part that is new each frame. sources: (cameras,), the source of each, -1: none. offsets: (cameras, 3), C - K. pose:
    turn in rad and place in m, standard deviations.
    """
    u, best, count = np.zeros(3), np.inf, 0
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
        chi2 = _descend(seen, sources, offsets, pose, u, start, fit, work)
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
    u, e1, e2, right, column = np.empty(3), np.empty(3), np.empty(3), np.empty(4), np.empty(4)
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
    table, work = np.zeros((len(chosen), FIT)), np.zeros((12, 4))
    for n in range(len(chosen)):
        fit_light(seen, chosen[n], offsets, pose, table[n], work)
        add_covariance(seen, chosen[n], offsets, pose, table[n], work)
    return table


def places(fit: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """The places (n, 3) m of fits (n, FIT) that are not at infinity."""
    return centre + fit[:, :3] / fit[:, 3:4]
