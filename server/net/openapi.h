/* SPDX-License-Identifier: MIT */
/* openapi.h owns proto/openapi.json inside the program, for GET /v1/openapi.json. */
#ifndef RELIGHTD_OPENAPI_H
#define RELIGHTD_OPENAPI_H

#include <stddef.h>

extern const unsigned char openapi_json[];
extern const size_t openapi_json_size;

#endif
