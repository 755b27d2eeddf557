/* SPDX-License-Identifier: GPL-3.0-or-later
 *
 * Covariance of the spectrum of the local light field: operators and readings. See covariance.h.
 *
 * The maps are written as elementary operations on the frequency vector Omega (scale a component,
 * add a multiple of one component to another), applied to rows and columns of Sigma alike. */
#include "optics/covariance.h"

#include <assert.h>
#include <float.h>
#include <math.h>

enum { X, Y, U, V, DIMENSIONS };

/* Row and column to packed index. */
static const int PACKED[DIMENSIONS][DIMENSIONS] = {
    {COVARIANCE_XX, COVARIANCE_XY, COVARIANCE_XU, COVARIANCE_XV},
    {COVARIANCE_XY, COVARIANCE_YY, COVARIANCE_YU, COVARIANCE_YV},
    {COVARIANCE_XU, COVARIANCE_YU, COVARIANCE_UU, COVARIANCE_UV},
    {COVARIANCE_XV, COVARIANCE_YV, COVARIANCE_UV, COVARIANCE_VV}};

static const double FOUR_PI_2 = 39.478417604357434;

/* A cell of uniform density has the variance extent^2 / 12, a disc radius^2 / 4. */
static const double CELL_VARIANCE = 1.0 / 12.0;

/* Extent given to a source that has none, relative to the extent that it has. The ratio of
 * variances, 1e-8, is near sqrt(DBL_EPSILON): there bias and rounding of S are equal. */
static const double EXTENT_RATIO_MIN = 1e-4;

/* A few dozen operators leave this much of an entry as rounding. */
static const double PIVOT_MIN = 64.0 * DBL_EPSILON;

static const double VALID_TOLERANCE = 1e-9;

/* Cosines arrive as dot products of rounded unit vectors. */
#define COS_MAX (1.0 + 1e-5)

static double square(double a) {
    return a * a;
}

static double *at(Covariance *sigma, int i, int j) {
    return &sigma->c[PACKED[i][j]];
}

static double get(const Covariance *sigma, int i, int j) {
    return sigma->c[PACKED[i][j]];
}

static bool is_finite(const Covariance *sigma) {
    for (int i = 0; i < 10; ++i) {
        if (!isfinite(sigma->c[i])) {
            return false;
        }
    }
    return true;
}

/* Omega_i *= factor. */
static void scale(Covariance *sigma, int i, double factor) {
    for (int k = 0; k < DIMENSIONS; ++k) {
        *at(sigma, i, k) *= k == i ? square(factor) : factor;
    }
}

/* Omega_i += factor Omega_j, i != j. */
static void shear(Covariance *sigma, int i, int j, double factor) {
    /* The diagonal first: it needs the old Sigma_ij. */
    *at(sigma, i, i) += factor * (2.0 * get(sigma, i, j) + factor * get(sigma, j, j));
    for (int k = 0; k < DIMENSIONS; ++k) {
        if (k != i) {
            *at(sigma, i, k) += factor * get(sigma, j, k);
        }
    }
}

/* Omega_i, Omega_j as seen from axes turned by the angle of this sine and cosine. */
static void turn(Covariance *sigma, int i, int j, double sin_phi, double cos_phi) {
    for (int k = 0; k < DIMENSIONS; ++k) {
        if (k != i && k != j) {
            const double a = get(sigma, i, k);
            const double b = get(sigma, j, k);
            *at(sigma, i, k) = cos_phi * a + sin_phi * b;
            *at(sigma, j, k) = cos_phi * b - sin_phi * a;
        }
    }
    const double ii = get(sigma, i, i);
    const double ij = get(sigma, i, j);
    const double jj = get(sigma, j, j);
    const double cc = square(cos_phi);
    const double ss = square(sin_phi);
    const double sc = sin_phi * cos_phi;
    *at(sigma, i, i) = cc * ii + 2.0 * sc * ij + ss * jj;
    *at(sigma, i, j) = sc * (jj - ii) + (cc - ss) * ij;
    *at(sigma, j, j) = ss * ii - 2.0 * sc * ij + cc * jj;
}

/* ---- Sources --------------------------------------------------------------------------------- */

/* 0 has no end of them: a point has every frequency. */
static double reciprocal(double x) {
    return x > 0.0 ? 1.0 / x : (double)INFINITY;
}

Covariance covariance_gaussian(double s_x, double s_y, double s_u, double s_v) {
    assert(s_x >= 0.0 && s_y >= 0.0 && s_u >= 0.0 && s_v >= 0.0);
    Covariance sigma = {{0.0}};
    sigma.c[COVARIANCE_XX] = reciprocal(FOUR_PI_2 * square(s_x));
    sigma.c[COVARIANCE_YY] = reciprocal(FOUR_PI_2 * square(s_y));
    sigma.c[COVARIANCE_UU] = reciprocal(FOUR_PI_2 * square(s_u));
    sigma.c[COVARIANCE_VV] = reciprocal(FOUR_PI_2 * square(s_v));
    return sigma;
}

Covariance covariance_point(double solid_angle, double distance) {
    return covariance_area(solid_angle, 0.0, distance);
}

Covariance covariance_directional(double area, double angular_radius, double distance) {
    assert(area > 0.0 && angular_radius >= 0.0 && distance > 0.0);
    const double s_x = sqrt(area * CELL_VARIANCE);
    const double s_u = fmax(0.5 * angular_radius, EXTENT_RATIO_MIN * s_x / distance);
    return covariance_gaussian(s_x, s_x, s_u, s_u);
}

Covariance covariance_spot(double solid_angle, double penumbra, double distance) {
    assert(penumbra > 0.0);
    Covariance sigma = covariance_point(solid_angle, distance);
    const double across[DIMENSIONS] = {0.0, 0.0, 1.0, 0.0};
    covariance_window(&sigma, across, penumbra * sqrt(CELL_VARIANCE));
    return sigma;
}

Covariance covariance_area(double solid_angle, double source_area, double distance) {
    assert(solid_angle > 0.0 && source_area >= 0.0 && distance > 0.0);
    const double s_u = sqrt(solid_angle * CELL_VARIANCE);
    const double s_x = fmax(sqrt(source_area * CELL_VARIANCE), EXTENT_RATIO_MIN * s_u * distance);
    return covariance_gaussian(s_x, s_x, s_u, s_u);
}

/* ---- Maps: specular transport ---------------------------------------------------------------- */

void covariance_travel(Covariance *sigma, double d) {
    assert(is_finite(sigma) && isfinite(d));
    shear(sigma, U, X, -d);
    shear(sigma, V, Y, -d);
}

void covariance_rotate(Covariance *sigma, double phi) {
    assert(is_finite(sigma) && isfinite(phi));
    const double sin_phi = sin(phi);
    const double cos_phi = cos(phi);
    turn(sigma, X, Y, sin_phi, cos_phi);
    turn(sigma, U, V, sin_phi, cos_phi);
}

void covariance_project(Covariance *sigma, double cos_theta) {
    assert(is_finite(sigma) && cos_theta > 0.0 && cos_theta <= COS_MAX);
    scale(sigma, Y, cos_theta);
}

void covariance_unproject(Covariance *sigma, double cos_theta) {
    assert(is_finite(sigma) && cos_theta > 0.0 && cos_theta <= COS_MAX);
    scale(sigma, Y, 1.0 / cos_theta);
}

void covariance_curvature(Covariance *sigma, double cos_theta, SurfaceCurvature k) {
    assert(is_finite(sigma) && cos_theta > 0.0 && cos_theta <= COS_MAX);
    /* [Belcour13] shears both axes by k alone; ours, derived in docs/covariance.md, has the cosine
     * that a turn of the normal out of the plane of incidence is seen under. */
    shear(sigma, X, U, -cos_theta * k.xx);
    shear(sigma, X, V, -k.xy);
    shear(sigma, Y, U, -cos_theta * k.xy);
    shear(sigma, Y, V, -k.yy);
}

bool covariance_refract(Covariance *sigma, double n1, double n2, double cos_i, SurfaceCurvature k) {
    assert(is_finite(sigma) && n1 > 0.0 && n2 > 0.0 && !(cos_i > COS_MAX));
    const double e = n1 / n2;
    const double cos2_t = 1.0 - square(e) * (1.0 - square(cos_i));
    if (!(cos_i >= COVARIANCE_COS_INCIDENT_MIN) || !(cos2_t > 0.0)) {
        return false;
    }
    const double cos_t = fmax(sqrt(cos2_t), COVARIANCE_COS_TRANSMITTED_MIN);
    covariance_project(sigma, cos_i);
    /* [Liang19] eq. 4 has diag(1, n1 c_i / (n2 c_t)) on the spectrum; ours, derived in
     * docs/covariance.md, is the inverse transpose of the primal map: a spectrum shrinks where
     * slopes widen, on both axes. */
    scale(sigma, U, 1.0 / e);
    scale(sigma, V, cos_t / (e * cos_i));
    /* The curvature met on the way in and that met on the way out, in one shear: their difference
     * G is what bends light, and cancels where n1 = n2. */
    const double g_u = cos_t - e * cos_i;
    const double g_v = g_u / cos_t;
    shear(sigma, X, U, g_u * k.xx);
    shear(sigma, X, V, g_v * k.xy);
    shear(sigma, Y, U, g_u * k.xy);
    shear(sigma, Y, V, g_v * k.yy);
    covariance_unproject(sigma, cos_t);
    return true;
}

void covariance_reflect(Covariance *sigma, double cos_i, SurfaceCurvature k) {
    assert(is_finite(sigma) && cos_i >= COVARIANCE_COS_INCIDENT_MIN && !(cos_i > COS_MAX));
    /* [Liang19] eq. 5 is the identity for a smooth mirror (B = 0): only curvature acts. */
    shear(sigma, X, U, -2.0 * cos_i * k.xx);
    shear(sigma, X, V, -2.0 * k.xy);
    shear(sigma, Y, U, -2.0 * k.xy);
    shear(sigma, Y, V, -2.0 / cos_i * k.yy);
}

/* ---- Effects that blur or cut ---------------------------------------------------------------- */

/* (Sigma^-1 + 4 pi^2 variance a a^T)^-1 for the unit vector of axis a, by Sherman-Morrison:
 *   Sigma - Sigma a a^T Sigma / (r + a^T Sigma a),   r = 1 / (4 pi^2 variance) */
static void convolve(Covariance *sigma, int a, double variance) {
    assert(variance >= 0.0);
    const double alpha = get(sigma, a, a);
    if (variance == 0.0 || alpha == 0.0) {
        return;
    }
    const double r = 1.0 / (FOUR_PI_2 * variance);
    if (isinf(alpha)) {
        /* A Dirac takes the shape of the lobe and with it loses what correlation it had. */
        for (int k = 0; k < DIMENSIONS; ++k) {
            *at(sigma, a, k) = k == a ? r : 0.0;
        }
        return;
    }
    double row[DIMENSIONS];
    for (int k = 0; k < DIMENSIONS; ++k) {
        row[k] = get(sigma, a, k);
    }
    for (int i = 0; i < DIMENSIONS; ++i) {
        for (int j = 0; j <= i; ++j) {
            if (i != a && j != a) {
                const double old = get(sigma, i, j);
                const double kept = old - row[i] / (r + alpha) * row[j];
                *at(sigma, i, j) = i == j && kept <= PIVOT_MIN * old ? 0.0 : kept;
            }
        }
    }
    /* The row of the axis itself without the subtraction, which would cancel. */
    for (int k = 0; k < DIMENSIONS; ++k) {
        *at(sigma, a, k) = row[k] * (r / (r + alpha));
    }
    /* What was pure rounding on the diagonal must not keep its correlations. */
    for (int i = 0; i < DIMENSIONS; ++i) {
        if (get(sigma, i, i) == 0.0) {
            scale(sigma, i, 0.0);
        }
    }
}

void covariance_convolve_angle(Covariance *sigma, double var_u, double var_v) {
    convolve(sigma, U, var_u);
    convolve(sigma, V, var_v);
}

void covariance_hg_variance(double g, double cos_theta, double *out_in_plane, double *out_across) {
    assert(g > -1.0 && g < 1.0 && fabs(cos_theta) <= COS_MAX);
    const double d = 1.0 + square(g) - 2.0 * g * cos_theta;
    const double across = -3.0 * g * cos_theta / d;
    const double in_plane = across + 15.0 * square(g) * (1.0 - square(cos_theta)) / square(d);
    *out_in_plane = reciprocal(fabs(in_plane));
    *out_across = reciprocal(fabs(across));
}

void covariance_scatter_hg(Covariance *sigma, double g, double cos_theta) {
    double in_plane;
    double across;
    covariance_hg_variance(g, cos_theta, &in_plane, &across);
    covariance_convolve_angle(sigma, across, in_plane);
}

void covariance_window(Covariance *sigma, const double h[4], double s) {
    assert(s > 0.0);
    const double weight = 1.0 / (FOUR_PI_2 * square(s));
    for (int i = 0; i < DIMENSIONS; ++i) {
        for (int j = 0; j <= i; ++j) {
            *at(sigma, i, j) += weight * h[i] * h[j];
        }
    }
}

void covariance_attenuate(Covariance *sigma, double sigma_t, double tan_theta) {
    assert(sigma_t >= 0.0 && isfinite(sigma_t * tan_theta));
    *at(sigma, Y, Y) += square(sigma_t * tan_theta) / FOUR_PI_2;
}

void covariance_add(Covariance *sigma, double *flux, const Covariance *other, double other_flux) {
    assert(*flux >= 0.0 && other_flux >= 0.0);
    if (other_flux == 0.0) {
        return;
    }
    if (*flux == 0.0) {
        /* Not a weighted mean: zero times an infinite entry has no value. */
        *sigma = *other;
        *flux = other_flux;
        return;
    }
    const double total = *flux + other_flux;
    for (int i = 0; i < 10; ++i) {
        sigma->c[i] = (*flux / total) * sigma->c[i] + (other_flux / total) * other->c[i];
    }
    *flux = total;
}

/* ---- What is read from it -------------------------------------------------------------------- */

/* Sigma = diag(root) r diag(root) with a unit diagonal in r: correlations are free of units, and
 * the scaling that makes a pivot's smallness mean something. An axis with a zero or infinite
 * diagonal is uncorrelated with the rest. */
typedef struct Correlation {
    double root[DIMENSIONS];
    double r[DIMENSIONS][DIMENSIONS];
} Correlation;

static Correlation correlation(const Covariance *sigma) {
    Correlation out;
    for (int i = 0; i < DIMENSIONS; ++i) {
        out.root[i] = sqrt(fmax(get(sigma, i, i), 0.0));
    }
    for (int i = 0; i < DIMENSIONS; ++i) {
        for (int j = 0; j < DIMENSIONS; ++j) {
            const double a = out.root[i];
            const double b = out.root[j];
            out.r[i][j] = a == 0.0 || b == 0.0 ? 0.0 : get(sigma, i, j) / a / b;
        }
        out.r[i][i] = out.root[i] > 0.0 ? 1.0 : 0.0;
    }
    return out;
}

/* Eliminates axes first .. DIMENSIONS-1, largest pivot first, leaving the Schur complement in the
 * other rows of c->r. Pivots not above `pivot_min` are left. Writes the axes in the order taken to
 * `order`, their pivots to `pivot`, and returns how many. */
static int eliminate(Correlation *c, int first, double pivot_min, int order[DIMENSIONS],
                     double pivot[DIMENSIONS]) {
    bool done[DIMENSIONS] = {false};
    int count = 0;
    for (;;) {
        int p = -1;
        for (int i = first; i < DIMENSIONS; ++i) {
            if (!done[i] && c->r[i][i] > pivot_min && (p < 0 || c->r[i][i] > c->r[p][p])) {
                p = i;
            }
        }
        if (p < 0) {
            return count;
        }
        done[p] = true;
        order[count] = p;
        pivot[count] = c->r[p][p];
        ++count;
        for (int i = 0; i < DIMENSIONS; ++i) {
            for (int j = 0; j < DIMENSIONS; ++j) {
                if (!done[i] && !done[j]) {
                    c->r[i][j] -= c->r[i][p] / c->r[p][p] * c->r[p][j];
                }
            }
        }
    }
}

CovarianceLogDet covariance_log_det(const Covariance *sigma) {
    Correlation c = correlation(sigma);
    int order[DIMENSIONS];
    double pivot[DIMENSIONS];
    const int count = eliminate(&c, 0, PIVOT_MIN, order, pivot);
    CovarianceLogDet out = {.zero_count = DIMENSIONS - count};
    for (int i = 0; i < count; ++i) {
        if (isinf(c.root[order[i]])) {
            ++out.infinite_count;
        } else {
            out.log_finite += log(pivot[i]) + 2.0 * log(c.root[order[i]]);
        }
    }
    return out;
}

SpatialCovariance covariance_spatial(const Covariance *sigma) {
    Correlation c = correlation(sigma);
    int order[DIMENSIONS];
    double pivot[DIMENSIONS];
    eliminate(&c, U, PIVOT_MIN, order, pivot);
    /* An axis whose remainder is rounding is uniform, and correlated with nothing. */
    const bool has_x = c.r[X][X] > PIVOT_MIN;
    const bool has_y = c.r[Y][Y] > PIVOT_MIN;
    const bool has_xy = has_x && has_y && !isinf(c.root[X]) && !isinf(c.root[Y]);
    return (SpatialCovariance){
        .xx = has_x ? c.r[X][X] * square(c.root[X]) : 0.0,
        .xy = has_xy ? c.r[X][Y] * c.root[X] * c.root[Y] : 0.0,
        .yy = has_y ? c.r[Y][Y] * square(c.root[Y]) : 0.0,
    };
}

double spatial_covariance_sqrt_det(SpatialCovariance s) {
    if (!(s.xx > 0.0 && s.yy > 0.0)) {
        return 0.0;
    }
    const double root_x = sqrt(s.xx);
    const double root_y = sqrt(s.yy);
    const double rho = s.xy / root_x / root_y;
    return root_x * root_y * sqrt(fmax((1.0 - rho) * (1.0 + rho), 0.0));
}

double covariance_frequency_factor(const Covariance *sigma, double area) {
    assert(area > 0.0);
    /* [Liang19] eq. 7 has sqrt|Sigma|; ours, derived in docs/covariance.md, is the part of it that
     * changes where light is focused. 4 pi^2 / 12: see the header, and the variance of a cell. */
    const double q =
        FOUR_PI_2 * CELL_VARIANCE * area * spatial_covariance_sqrt_det(covariance_spatial(sigma));
    return 1.0 - 1.0 / (1.0 + q);
}

bool covariance_is_valid(const Covariance *sigma) {
    for (int i = 0; i < DIMENSIONS; ++i) {
        for (int j = 0; j < i; ++j) {
            const double ij = get(sigma, i, j);
            const bool is_uniform = get(sigma, i, i) == 0.0 || get(sigma, j, j) == 0.0;
            if (!isfinite(ij) || (is_uniform && ij != 0.0)) {
                return false;
            }
        }
        if (!(get(sigma, i, i) >= 0.0)) {
            return false;
        }
    }
    Correlation c = correlation(sigma);
    int order[DIMENSIONS];
    double pivot[DIMENSIONS];
    const int count = eliminate(&c, 0, VALID_TOLERANCE, order, pivot);
    bool done[DIMENSIONS] = {false};
    for (int i = 0; i < count; ++i) {
        done[order[i]] = true;
    }
    for (int i = 0; i < DIMENSIONS; ++i) {
        for (int j = 0; j <= i; ++j) {
            /* With no pivot left, a semi-definite remainder is no larger than its diagonal. */
            if (!done[i] && !done[j] && fabs(c.r[i][j]) > VALID_TOLERANCE) {
                return false;
            }
        }
    }
    return true;
}

/* ---- The square-root form -------------------------------------------------------------------- */

/* Adds one row to the upper triangular r of a QR factorisation, by Givens rotations. */
static void add_row(double r[DIMENSIONS][DIMENSIONS], double row[DIMENSIONS]) {
    for (int i = 0; i < DIMENSIONS; ++i) {
        const double length = hypot(r[i][i], row[i]);
        if (length == 0.0) {
            continue;
        }
        const double cos_phi = r[i][i] / length;
        const double sin_phi = row[i] / length;
        for (int j = i; j < DIMENSIONS; ++j) {
            const double a = r[i][j];
            const double b = row[j];
            r[i][j] = cos_phi * a + sin_phi * b;
            row[j] = cos_phi * b - sin_phi * a;
        }
    }
}

/* Inverse of an upper triangular matrix. */
static void invert_upper(double r[DIMENSIONS][DIMENSIONS], double out[DIMENSIONS][DIMENSIONS]) {
    for (int j = 0; j < DIMENSIONS; ++j) {
        for (int i = DIMENSIONS - 1; i >= 0; --i) {
            double sum = i == j ? 1.0 : 0.0;
            for (int k = i + 1; k <= j; ++k) {
                sum -= r[i][k] * out[k][j];
            }
            out[i][j] = i <= j ? sum / r[i][i] : 0.0;
        }
    }
}

bool covariance_from_tangents(const LocalTangent *tangents, int count, Covariance *out_sigma) {
    assert(count >= 0);
    /* Unit root mean square per axis, so that "too small a pivot" has no units. */
    double root[DIMENSIONS] = {0.0};
    for (int k = 0; k < count; ++k) {
        for (int i = 0; i < DIMENSIONS; ++i) {
            root[i] = hypot(root[i], tangents[k].q[i]);
        }
    }
    for (int i = 0; i < DIMENSIONS; ++i) {
        if (!(root[i] > 0.0)) {
            return false;
        }
    }
    double r[DIMENSIONS][DIMENSIONS] = {{0.0}};
    for (int k = 0; k < count; ++k) {
        double row[DIMENSIONS];
        for (int i = 0; i < DIMENSIONS; ++i) {
            row[i] = tangents[k].q[i] / root[i];
        }
        add_row(r, row);
    }
    for (int i = 0; i < DIMENSIONS; ++i) {
        if (!(fabs(r[i][i]) > PIVOT_MIN)) {
            return false;
        }
    }
    /* C = R^T R, hence C^-1 = R^-1 R^-T. */
    double inverse[DIMENSIONS][DIMENSIONS];
    invert_upper(r, inverse);
    for (int i = 0; i < DIMENSIONS; ++i) {
        for (int j = 0; j <= i; ++j) {
            double sum = 0.0;
            for (int k = i; k < DIMENSIONS; ++k) {
                sum += inverse[i][k] * inverse[j][k];
            }
            *at(out_sigma, i, j) = sum / FOUR_PI_2 / root[i] / root[j];
        }
    }
    return true;
}

bool covariance_to_tangents(const Covariance *sigma, LocalTangent out_tangents[4]) {
    if (!is_finite(sigma)) {
        return false;
    }
    const Correlation c = correlation(sigma);
    /* Sigma = root L L^T root; its inverse square root is root^-1 L^-T. */
    double upper[DIMENSIONS][DIMENSIONS] = {{0.0}};
    for (int j = 0; j < DIMENSIONS; ++j) {
        for (int i = j; i < DIMENSIONS; ++i) {
            double sum = c.r[i][j];
            for (int k = 0; k < j; ++k) {
                sum -= upper[k][i] * upper[k][j];
            }
            if (i == j && !(sum > PIVOT_MIN)) {
                return false;
            }
            upper[j][i] = i == j ? sqrt(sum) : sum / upper[j][j];
        }
    }
    double inverse[DIMENSIONS][DIMENSIONS];
    invert_upper(upper, inverse);
    for (int k = 0; k < DIMENSIONS; ++k) {
        for (int i = 0; i < DIMENSIONS; ++i) {
            out_tangents[k].q[i] = inverse[i][k] / c.root[i] / sqrt(FOUR_PI_2);
        }
    }
    return true;
}

SpatialCovariance spatial_covariance_from_tangents(const LocalTangent *tangents, int count) {
    assert(count >= 0);
    double xx = 0.0;
    double xy = 0.0;
    double yy = 0.0;
    double det = 0.0;
    for (int k = 0; k < count; ++k) {
        const double *a = tangents[k].q;
        xx += square(a[X]);
        xy += a[X] * a[Y];
        yy += square(a[Y]);
        /* Cauchy-Binet: |J J^T| as a sum of squares, where xx yy - xy^2 would cancel. */
        for (int l = 0; l < k; ++l) {
            det += square(a[X] * tangents[l].q[Y] - a[Y] * tangents[l].q[X]);
        }
    }
    if (!(det > 0.0)) {
        return (SpatialCovariance){.xx = (double)INFINITY, .yy = (double)INFINITY};
    }
    return (SpatialCovariance){
        .xx = yy / det / FOUR_PI_2, .xy = -xy / det / FOUR_PI_2, .yy = xx / det / FOUR_PI_2};
}
