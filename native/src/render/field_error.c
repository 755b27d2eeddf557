/* SPDX-License-Identifier: GPL-3.0-or-later
 * What fields of several levels tell about their errors. */
#include "render/field_error.h"

#include <math.h>

static double clamp(double x, double low, double high) {
    return fmin(fmax(x, low), high);
}

/* Squared distance of neighbours in units of the finer one's squared error. */
static double neighbour_square(FieldConvergence f) {
    return 1.0 + f.ratio * f.ratio - 2.0 * f.correlation * f.ratio;
}

FieldConvergence field_convergence(const FieldDifferences *differences, uint32_t top,
                                   const FieldPrior *prior) {
    if (top < 2)
        return prior->usual;
    const double coarse = differences->squares[top - 2][top - 1];
    const double fine = differences->squares[top - 1][top];
    const double both = differences->squares[top - 2][top];
    if (!(coarse > 0.0 && fine > 0.0 && both > 0.0))
        return prior->usual;
    const double r = clamp(sqrt(coarse / fine), prior->ratio_min, prior->ratio_max);
    /* both / fine = (1 + r^4 - 2 c^2 r^2) / (1 + r^2 - 2 c r) is a quadratic equation for c:
     * r^2 c^2 - b r c + (b (1 + r^2) - 1 - r^4) / 2 = 0; its smaller root is the one in [0, 1]. */
    const double b = both / fine;
    const double root = b * b - 2.0 * (b * (1.0 + r * r) - 1.0 - r * r * r * r);
    const double c = (b - sqrt(fmax(root, 0.0))) / (2.0 * r);
    return (FieldConvergence){r, clamp(c, 0.0, prior->correlation_max)};
}

double field_error_square(const FieldDifferences *differences, uint32_t level,
                          const FieldPrior *prior) {
    const uint32_t finest = differences->level_count - 1;
    /* Against a finer level where there is one: the less of the error is extrapolated. */
    const uint32_t top = level < finest ? level + 1 : level;
    const FieldConvergence f = field_convergence(differences, top, prior);
    const double square = differences->squares[top - 1][top] / neighbour_square(f);
    return level < finest ? square * f.ratio * f.ratio : square;
}
