/* SPDX-License-Identifier: GPL-3.0-or-later
 *
 * Covariance of the spectrum of the local light field: the explicit 4x4 form.
 *
 * Based on: Belcour et al. 2013 and 2014 [Belcour13, Belcour14], as used by [Liang19] sec. 3.1.
 * Derivations, and where the printed equations are not followed: docs/covariance.md.
 *
 * The light around a central ray is a function f(x, y, u, v): offsets x, y in metres in the plane
 * normal to the ray, and slopes u, v (small angles, radians) of the direction d + u ex + v ey.
 * The frame (ex, ey, d) is orthonormal; right-handed, ey = d x ex, until a mirror turns it over
 * (covariance_reflect). No operator asks for its handedness.
 * Sigma is the matrix of second moments of the spectrum |F f|, frequencies Omega in exp(-2 pi i
 * Omega.q): cycles per metre and per radian. A Gaussian f of covariance C has
 *
 *     Sigma = C^-1 / (4 pi^2),
 *
 * so a narrow light field has a large Sigma. When a specular event maps rays by q' = M q,
 * C' = M C M^T and Sigma' = M^-T Sigma M^-1. Every operator below is exact for Gaussians, to first
 * order in q.
 *
 * Range. The maps (travel, rotate, project, unproject, curvature, refract, reflect) need finite
 * entries. Everything else also accepts +infinity on the diagonal, with finite numbers beside it:
 * an ideal point (x, y) or an ideal direction (u, v). Zero is always allowed: a uniform field.
 * A matrix holds its smallest feature to DBL_EPSILON times its condition number (of Sigma scaled to
 * a unit diagonal). That reaches 1e8 once a source below has travelled `distance`, where the
 * spatial spectrum S keeps 7 digits; a surface of curvature K costs a factor (K distance)^2 more.
 * The renderer carries the square-root form (tangent pairs), which has no such limit; this module
 * audits it.
 *
 * All functions are pure but for their first argument; any thread.
 */
#ifndef AMB_OPTICS_COVARIANCE_H
#define AMB_OPTICS_COVARIANCE_H

#include <stdbool.h>

/* Symmetric, packed by columns of the upper triangle:
 *
 *        x  y  u  v            units   x,y          u,v
 *   x  [ 0  1  3  6 ]            x,y   1/m^2        1/(m rad)
 *   y  [    2  4  7 ]            u,v                1/rad^2
 *   u  [       5  8 ]
 *   v  [          9 ]          order as in Belcour's reference code. */
typedef struct Covariance {
    double c[10];
} Covariance;

enum {
    COVARIANCE_XX,
    COVARIANCE_XY,
    COVARIANCE_YY,
    COVARIANCE_XU,
    COVARIANCE_YU,
    COVARIANCE_UU,
    COVARIANCE_XV,
    COVARIANCE_YV,
    COVARIANCE_UV,
    COVARIANCE_VV
};

/* Curvature of a surface, 1/m: the normal N, towards the incident side, turns by dN = K dX along
 * the tangent vectors X = ex (normal to the plane of incidence) and Y (in it, along the projection
 * of ey). A convex surface seen from outside has K > 0: a sphere of radius R has I/R from outside
 * and -I/R from inside. */
typedef struct SurfaceCurvature {
    double xx, xy, yy;
} SurfaceCurvature;

/* Spatial spectrum of the fluence, 1/m^2; see covariance_spatial. */
typedef struct SpatialCovariance {
    double xx, xy, yy;
} SpatialCovariance;

/* A determinant that may be zero, infinite, or a product of both. */
typedef struct CovarianceLogDet {
    double log_finite;  /* sum of ln(pivot) over pivots that are finite and not zero, SI units */
    int zero_count;     /* directions in which the field is uniform */
    int infinite_count; /* directions in which the field is a Dirac */
} CovarianceLogDet;

/* Below this cosine of incidence nothing is refracted: the flux falls with its square. */
#define COVARIANCE_COS_INCIDENT_MIN 1e-4
/* Beside the critical angle c_i / c_t diverges; the cosine in the derivative stops here. */
#define COVARIANCE_COS_TRANSMITTED_MIN 1e-3

/* ---- Sources --------------------------------------------------------------------------------- */

/* A Gaussian light field with the given standard deviations, no correlation.
 *   Sigma = diag(1/s_x^2, 1/s_y^2, 1/s_u^2, 1/s_v^2) / (4 pi^2)
 * s_x, s_y in m, s_u, s_v in rad, each in [0, inf]: 0 is an ideal point or direction (infinite
 * entry), inf a uniform field (zero entry). */
Covariance covariance_gaussian(double s_x, double s_y, double s_u, double s_v);

/* The four sources below give the light that one stratified sample stands for: a cell of uniform
 * density counts with its variance, extent^2 / 12. An extent that the ideal source lacks becomes
 * 1e-4 of the other one, carried over `distance`: a bias of 1e-8 where light and surface are
 * `distance` apart, 1e-4 at a hundredth (point) or a hundred times (directional) of it.
 * distance > 0, m; solid_angle > 0, sr; area > 0, m^2. */

/* Point light, cell of directions of the given solid angle: s_u^2 = solid_angle / 12. */
Covariance covariance_point(double solid_angle, double distance);

/* Parallel light, cell of the given area perpendicular to the beam: s_x^2 = area / 12. The disc of
 * the source is angular_radius in [0, pi/2) rad as seen from the scene: s_u^2 = angular_radius^2 /
 * 4. */
Covariance covariance_directional(double area, double angular_radius, double distance);

/* Point light whose cell lies in the blurred edge of a cone: a window of width penumbra > 0 rad
 * (uniform: variance width^2 / 12) on u, so ex must point across the edge. */
Covariance covariance_spot(double solid_angle, double penumbra, double distance);

/* Light of source_area (m^2, as seen along the ray) and a cell of directions. */
Covariance covariance_area(double solid_angle, double source_area, double distance);

/* ---- Maps: specular transport ---------------------------------------------------------------- */

/* Travels d metres (any sign) in a homogeneous medium.
 *   x += d u   =>   Omega_u -= d Omega_x            [Liang19] eq. 2, Table 1 */
void covariance_travel(Covariance *sigma, double d);

/* Turns the frame by phi radians about the ray, from ex towards ey; the light stays.
 *   q' = R^T q,  Sigma' = R^T Sigma R                [Liang19] Table 1 */
void covariance_rotate(Covariance *sigma, double phi);

/* Projects y, which must lie in the plane of incidence, onto the tangent plane, and back.
 *   Y = y / c   =>   Omega_Y = c Omega_y             [Belcour13]
 * cos_theta in (0, 1]: cosine between ray and normal on the side concerned. The slopes stay those
 * of the ray, hence a determinant of c^2 that leaving the surface takes back. */
void covariance_project(Covariance *sigma, double cos_theta);
void covariance_unproject(Covariance *sigma, double cos_theta);

/* Refers slopes to the local normal of a curved surface, in tangent coordinates (X, Y).
 *   u += c (Kxx X + Kxy Y),  v += Kxy X + Kyy Y
 *   =>   Omega_X -= c Kxx Omega_u + Kxy Omega_v,  Omega_Y -= c Kxy Omega_u + Kyy Omega_v
 * Leaving through the surface takes -K and the cosine of the new side; leaving after a mirror
 * takes +K, for the ray has turned round. Belcour's reference code has no c. */
void covariance_curvature(Covariance *sigma, double cos_theta, SurfaceCurvature k);

/* Refracts from index n1 to n2 at a curved surface, ex normal to the plane of incidence; the new
 * frame keeps ex and the sense of ey. With e = n1/n2, G = n2 c_t - n1 c_i:
 *   x' = x              u' = e u           - (G/n2)     (Kxx x + Kxy y/c_i)
 *   y' = (c_t/c_i) y    v' = e (c_i/c_t) v - (G/n2 c_t) (Kxy x + Kyy y/c_i)     det M = e^2
 * n1, n2 > 0; cos_i in (0, 1]. Returns false and leaves sigma alone at total internal reflection
 * and below COVARIANCE_COS_INCIDENT_MIN. */
bool covariance_refract(Covariance *sigma, double n1, double n2, double cos_i, SurfaceCurvature k);

/* Reflects at a smooth curved mirror, total internal reflection included.
 *   x' = x,  u' = u + 2 c Kxx x + 2 Kxy y
 *   y' = y,  v' = v + 2 Kxy x + (2/c) Kyy y
 * cos_i in [COVARIANCE_COS_INCIDENT_MIN, 1]. ex stays, and the new ey has the projection onto the
 * surface that the old one had: a right-handed frame becomes left-handed, and a second mirror turns
 * it back. To have a right-handed one at once, negate y and v. */
void covariance_reflect(Covariance *sigma, double cos_i, SurfaceCurvature k);

/* ---- Effects that blur or cut ---------------------------------------------------------------- */

/* Convolves in angle with a lobe of variances var_u, var_v (rad^2, in [0, inf]).
 *   C += diag(0, 0, var_u, var_v)   =>   Sigma' = (Sigma^-1 + B)^-1,  B = 4 pi^2 diag(0, 0, ..)
 * One axis at a time by Sherman-Morrison, so Sigma may be singular; var = inf kills the axis.
 * [Liang19] eq. 5. Turn the frame first for a lobe with other axes; a smooth mirror has B = 0. */
void covariance_convolve_angle(Covariance *sigma, double var_u, double var_v);

/* Scatters with a Henyey-Greenstein phase function through the angle theta; ey lies in the plane
 * of scattering. g in (-1, 1), cos_theta in [-1, 1], both directions along travel (forward = +1).
 * Convolves with covariance_hg_variance; g = 0 kills the angular frequencies and leaves S.
 * The spatial block is passed on as it is, exact for theta = 0. */
void covariance_scatter_hg(Covariance *sigma, double g, double cos_theta);

/* Variances (rad^2) of the Gaussians that have the curvature of the phase function at theta.
 *   D = 1 + g^2 - 2 g cos_theta
 *   1/var_in_plane = |p''/p|       = |15 g^2 sin^2 theta / D^2 - 3 g cos_theta / D|
 *   1/var_across   = |p' cot(theta)/p| = |3 g cos_theta / D|
 * On the axis both are (1-g)^2 / (3 g). Infinite where the curvature vanishes. This is the width
 * of the peak, not the variance of the scattering angle, which the tails dominate. */
void covariance_hg_variance(double g, double cos_theta, double *out_in_plane, double *out_across);

/* Multiplies the light field by a Gaussian window of standard deviation s > 0 along h.q, with h in
 * 1/m and 1/rad scaled as s is: an occluder's edge, an aperture, a Fresnel falloff.
 *   Sigma += h h^T / (4 pi^2 s^2)
 * An aperture of width w counts as s = w / sqrt(12). Travel to the plane of the occluder first. */
void covariance_window(Covariance *sigma, const double h[4], double s);

/* Attenuates in a homogeneous medium behind a boundary tilted by tan_theta against the ray's normal
 * plane: neighbours travel y tan_theta further, so the flux falls as exp(-a y), a = sigma_t
 * tan_theta (1/m).
 *   Sigma_yy += a^2 / (4 pi^2)
 * An upper bound for fields wider than 1/a: a tilted Gaussian is a shifted Gaussian, with the same
 * C. Uniform attenuation changes nothing. sigma_t >= 0, 1/m. */
void covariance_attenuate(Covariance *sigma, double sigma_t, double tan_theta);

/* Adds a light field to another, weighted by flux (W); both in the same frame.
 *   Sigma = (flux Sigma + other_flux Other) / (flux + other_flux),   *flux += other_flux
 * Fluxes >= 0; nothing happens where other_flux is zero. */
void covariance_add(Covariance *sigma, double *flux, const Covariance *other, double other_flux);

/* ---- What is read from it -------------------------------------------------------------------- */

/* ln |Sigma|, by elimination with diagonal pivoting on Sigma scaled to a unit diagonal (no
 * overflow, no dependence on units). A pivot below 64 DBL_EPSILON of its diagonal is zero. */
CovarianceLogDet covariance_log_det(const Covariance *sigma);

/* Spectrum of the fluence: the slice of the spectrum at zero angular frequency.
 *   S = S_xx - S_xu S_uu^+ S_ux = (4 pi^2 C_xx)^-1
 * Zero pivots of S_uu count as their pseudo-inverse, infinite ones drop out. Entries 1/m^2, +inf
 * on the diagonal where the source is an ideal point. */
SpatialCovariance covariance_spatial(const Covariance *sigma);

/* sqrt|S| in 1/m^2, in [0, inf]: for a point source equal to 1/(4 pi^2 s_u^2 |det B|), B the
 * derivative of position by the angle at the source, hence proportional to irradiance. */
double spatial_covariance_sqrt_det(SpatialCovariance s);

/* How much the light has been concentrated, in [0, 1].
 *   q = (pi^2/3) area sqrt|S|,   factor = q / (1 + q)
 * With a covariance started from the cell of a sample (sources above) and area = a_0 its
 * cross-section on entry (m^2), q = a_0 / a, a the present cross-section: 1/2 unfocused, 1 at a
 * focus, 0 far away. [Liang19] eq. 7 has sqrt|Sigma|, which is constant along a lossless specular
 * path; ours in docs/covariance.md, "Frequency factor". area > 0. */
double covariance_frequency_factor(const Covariance *sigma, double area);

/* True if Sigma is positive semi-definite up to rounding (1e-9 after scaling to a unit diagonal)
 * and holds no NaN. */
bool covariance_is_valid(const Covariance *sigma);

/* ---- The square-root form -------------------------------------------------------------------- */

/* What one random parameter of unit variance does to a ray: x, y in m, u, v in rad. Independent
 * parameters t_k give C = sum_k t_k t_k^T. (The tangent pairs of optics/tangent.h, expressed in the
 * local frame; a pair that spans a whole uniform cell counts 1/sqrt(12).) */
typedef struct LocalTangent {
    double q[4];
} LocalTangent;

/* Sigma = C^-1/(4 pi^2), through a QR factorisation: C is never formed, its condition never
 * squared. Returns false, *out_sigma untouched, when the tangents span fewer than four dimensions
 * (Sigma unbounded: an ideal point or direction). count >= 0. */
bool covariance_from_tangents(const LocalTangent *tangents, int count, Covariance *out_sigma);

/* Four tangents with sum_k t_k t_k^T = Sigma^-1/(4 pi^2), from a Cholesky factor. Returns false,
 * out_tangents untouched, when Sigma is singular or holds infinities. */
bool covariance_to_tangents(const Covariance *sigma, LocalTangent out_tangents[4]);

/* S of any number of tangents: (4 pi^2 sum x x^T)^-1. Exact for Dirac sources too, where Sigma does
 * not exist; +inf on the diagonal at a focus. */
SpatialCovariance spatial_covariance_from_tangents(const LocalTangent *tangents, int count);

#endif
