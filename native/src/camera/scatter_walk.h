/* SPDX-License-Identifier: GPL-3.0-or-later
 * Light of two and more scatterings, by a random walk from the camera. */
#ifndef AMB_CAMERA_SCATTER_WALK_H
#define AMB_CAMERA_SCATTER_WALK_H

#include "camera/walker.h"

/* Whether the effects ask for anything that a walk brings. */
bool walk_is_wanted(const CameraParams *params);

/* Adds light of an order to the sample, where it is wanted. */
void walk_add(Walker *walker, uint32_t order, Rgb light);

/* Adds to the sample what scatters inside a medium at least once on the walk's side: light of
 * lamps that the field gathers along each segment after k scatterings has order k + 1, light of
 * the world and of lit opaque surfaces that the walk meets after k of them has order k, and more
 * where it scattered on its way to these. A walk that begins behind a surface which one met goes
 * on counting where that was (walker->scattered).
 *
 * o + t d is a stretch of a camera path in the scattering medium of the stack before its first
 * internal reflection, throughput what the path has there. The walk follows any number of internal
 * reflections before its first scattering, and everything after it; where the stretch refracts
 * before anything else the path's own branches go on, and the walk ends. forward: optical depth of
 * the path so far that scatters straight on; see scatter_gather. is_seen: the path's own branches
 * add what scatters straight on along them, and the walk where these do not go. */
void walk_scatter(Walker *walker, Vec3 o, Vec3 d, const MediumStack *stack, Rgb throughput,
                  Rgb forward, bool is_seen);

/* What an object's medium scatters straight on, 1/m, where photons bring later orders and these are
 * wanted; else black. */
Rgb walk_straight(const CameraParams *params, uint32_t object);

/* Adds what of light gathered along a segment of a camera path went straight on after it scattered,
 * as orders two and more; forward: as walk_scatter's. */
void walk_add_straight(const CameraParams *params, CameraSample *sample, const CameraWay *way,
                       Rgb forward, Rgb throughput, const FieldRadiance *gathered);

/* Adds what a path sees of light of the surroundings that scattered straight on, once and more, on
 * a way of that depth: photons in cells do not have it. light: what arrives without having
 * scattered. */
void walk_see_straight(Walker *walker, const CameraWay *way, Rgb forward, Rgb light);

#endif
