/* SPDX-License-Identifier: GPL-3.0-or-later
 * Public functions: status, version, self-test. */
#include <stddef.h>

#include "base/status.h"
#include "scene/intersect.h"

void amb_last_error(AmbErrorInfo *out_info) {
    if (out_info != NULL)
        status_copy_record(out_info);
}

const char *amb_status_name(AmbStatus status) {
    switch (status) {
#define STATUS_CASE(name, value, message)                                                          \
    case AMB_##name:                                                                               \
        return #name;
        AMB_STATUS_LIST(STATUS_CASE)
#undef STATUS_CASE
    default:
        return "UNKNOWN";
    }
}

uint32_t amb_abi_version(void) {
    return AMB_ABI_VERSION;
}

const char *amb_version_string(void) {
    return AMB_VERSION_STRING;
}

uint64_t amb_struct_size(uint32_t struct_id) {
    static const uint64_t sizes[AMB_STRUCT_COUNT] = {
        [AMB_STRUCT_ERROR_INFO] = sizeof(AmbErrorInfo),
        [AMB_STRUCT_PHASE_LOBE] = sizeof(AmbPhaseLobe),
        [AMB_STRUCT_MATERIAL] = sizeof(AmbMaterial),
        [AMB_STRUCT_MESH] = sizeof(AmbMesh),
        [AMB_STRUCT_OBJECT] = sizeof(AmbObject),
        [AMB_STRUCT_LIGHT] = sizeof(AmbLight),
        [AMB_STRUCT_CAMERA] = sizeof(AmbCamera),
        [AMB_STRUCT_RENDER_PARAMS] = sizeof(AmbRenderParams),
        [AMB_STRUCT_PROGRESS] = sizeof(AmbProgress),
        [AMB_STRUCT_WORLD_IMAGE] = sizeof(AmbWorldImage),
        [AMB_STRUCT_TEXTURE] = sizeof(AmbTexture),
    };
    return struct_id < AMB_STRUCT_COUNT ? sizes[struct_id] : 0;
}

AmbStatus amb_self_test(void) {
    status_enter("amb_self_test");
    return intersector_self_test();
}
