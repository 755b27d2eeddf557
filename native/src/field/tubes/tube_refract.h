/* SPDX-License-Identifier: GPL-3.0-or-later
 * Light that tubes refract between their corners. */
#ifndef AMB_FIELD_TUBES_TUBE_REFRACT_H
#define AMB_FIELD_TUBES_TUBE_REFRACT_H

#include "field/tubes/tube_lanes.h"

/* The normals at the corners, found again from how light was refracted there:
 * w - eta d is along the normal. */
static inline Lanes3 normal_at(const TubeLight *light, Lanes3 d, Lanes3 w) {
    const Lanes3 n = sub3(w, scale3(d, lanes_set(light->eta)));
    const LaneMask is_back = dot3(n, d) > 0.0f;
    return normalize3(scale3(n, lanes_select(is_back, lanes_set(-1.0f), lanes_set(1.0f))));
}

static inline Lanes3 light_direction(const TubeLight *light, Lanes3 x) {
    const Lanes3 origin = set3(light->origin);
    return light->is_directional ? origin : normalize3(sub3(x, origin));
}

/* Light along unit d, refracted at normal n, which need not be unit: as enter_at of tube_cut.c. */
static inline Lanes3 refract(const TubeLight *light, Lanes3 d, Lanes3 n) {
    if (light->eta == 1.0f)
        return d;
    const Lanes zero = lanes_set(0.0f), eta = lanes_set(light->eta);
    n = normalize3(n);
    const Lanes missing = lanes_max(TUBE_GRAZING_COS + dot3(d, n), zero);
    n = normalize3(sub3(n, scale3(d, missing)));
    const Lanes cos_i = -dot3(d, n);
    const Lanes cos_t =
        lanes_sqrt(lanes_max((1.0f - eta) * (1.0f + eta) + eta * eta * (cos_i * cos_i), zero));
    return normalize3(add3(scale3(d, eta), scale3(n, eta * cos_i - cos_t)));
}

#endif
