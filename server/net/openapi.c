// SPDX-License-Identifier: MIT
// The description of the HTTP API, as it is installed.
#include "net/openapi.h"

const unsigned char openapi_json[] = {
#include "openapi_bytes.h"
};
const size_t openapi_json_size = sizeof openapi_json;
