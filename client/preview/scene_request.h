/* SPDX-License-Identifier: MIT */
/* scene_request.h declares how a room's Scene becomes a request for its picture. */
#ifndef RELIGHT_PREVIEW_SCENE_REQUEST_H
#define RELIGHT_PREVIEW_SCENE_REQUEST_H

#include "relight/relight.h"

#include <cjson/cJSON.h>
#include <protobuf-c/protobuf-c.h>

enum { SCENE_LIGHTS = 16, SCENE_MATERIALS = 64 };

/* An image request with the arrays and the message that its pointers point into. */
struct scene_request {
    struct relight_image_request request;
    struct relight_light light[SCENE_LIGHTS];
    struct relight_object_material material[SCENE_MATERIALS];
    ProtobufCMessage *scene;
};
/* scene: JSON of a Scene. Returns 0 and *out, to be ended by scene_request_finish; otherwise
 * -RELIGHT_E_PROTOCOL, and the error names the field, or -RELIGHT_E_NO_MEMORY. */
int scene_request_make(const cJSON *scene, struct scene_request *out,
                       struct relight_error *error);
void scene_request_finish(struct scene_request *request);

#endif
