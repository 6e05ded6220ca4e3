// SPDX-License-Identifier: MIT
// What a room accepts at all: finite numbers, bounded texts and lists, no unknown fields.
#include "rooms/state.h"

#include "prt/medium.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

static bool fault(char error[ROOM_ERROR], const ProtobufCFieldDescriptor *field,
                  const char *what)
{
    snprintf(error, ROOM_ERROR, "%s: %s", field->name, what);
    return false;
}

static bool value_sane(const ProtobufCFieldDescriptor *field, const void *at,
                       char error[ROOM_ERROR])
{
    switch (field->type) {
    case PROTOBUF_C_TYPE_FLOAT:
        return isfinite(*(const float *)at) || fault(error, field, "not a finite number");
    case PROTOBUF_C_TYPE_DOUBLE:
        return isfinite(*(const double *)at) || fault(error, field, "not a finite number");
    case PROTOBUF_C_TYPE_STRING:
        return strlen(*(char *const *)at) <= ROOM_MAX_MATERIAL ||
               fault(error, field, "too long");
    case PROTOBUF_C_TYPE_MESSAGE:
        return !*(void *const *)at || room_message_sane(*(ProtobufCMessage *const *)at, error);
    default:
        return true;
    }
}

static size_t value_size(const ProtobufCFieldDescriptor *field)
{
    switch (field->type) {
    case PROTOBUF_C_TYPE_DOUBLE:
    case PROTOBUF_C_TYPE_UINT64:
    case PROTOBUF_C_TYPE_FIXED64:
        return 8;
    case PROTOBUF_C_TYPE_STRING:
    case PROTOBUF_C_TYPE_MESSAGE:
        return sizeof(void *);
    default:
        return 4;
    }
}

bool room_message_sane(const ProtobufCMessage *message, char error[ROOM_ERROR])
{
    const ProtobufCMessageDescriptor *d = message->descriptor;
    const char *base = (const char *)message;
    if (message->n_unknown_fields) {
        snprintf(error, ROOM_ERROR, "%s has a field that this daemon does not know",
                 d->short_name);
        return false;
    }
    for (unsigned i = 0; i < d->n_fields; i++) {
        const ProtobufCFieldDescriptor *field = &d->fields[i];
        const char *at = base + field->offset;
        size_t n = 1, size = value_size(field);
        if (field->label == PROTOBUF_C_LABEL_REPEATED) {
            n = *(const size_t *)(base + field->quantifier_offset);
            at = *(char *const *)at;
        }
        for (size_t j = 0; j < n; j++)
            if (!value_sane(field, at + j * size, error)) return false;
    }
    return true;
}

static int scene_fault(char error[ROOM_ERROR], int code, const char *text)
{
    snprintf(error, ROOM_ERROR, "scene: %s", text);
    return code;
}

int room_scene_check(const Relight__Scene *scene, char error[ROOM_ERROR])
{
    if (!scene) return 0;
    if (scene->n_lights > 16)
        return scene_fault(error, RELIGHT__ERROR_CODE__ERROR_LIMIT, "at most 16 lights");
    for (size_t i = 0; i < scene->n_lights; i++)
        if (scene->lights[i]->cube_n)
            return scene_fault(error, RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST,
                               "a light with texels: upload its image and name it as env:HASH");
    size_t n = strlen(scene->model);
    if (n && (n != 32 || strspn(scene->model, "0123456789abcdef") != n))
        return scene_fault(error, RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST,
                           "model: expected an id of 32 hex digits, as INFO gives it");
    if (scene->shade && *scene->shade->material)
        return scene_fault(error, RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST,
                           "shade.material: the material is a field of the scene");
    if (scene->shade && scene->shade->n_materials > PRT_MEDIA_MAX)
        return scene_fault(error, RELIGHT__ERROR_CODE__ERROR_LIMIT,
                           "shade.materials: at most 64 media by object");
    for (size_t i = 0; scene->shade && i < scene->shade->n_materials; i++)
        if (!*scene->shade->materials[i]->object || !*scene->shade->materials[i]->material)
            return scene_fault(error, RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST,
                               "shade.materials: object or material is missing");
    if (scene->picture && scene->picture->camera)
        return scene_fault(error, RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST,
                           "picture.camera: the camera is a field of the scene");
    return 0;
}
