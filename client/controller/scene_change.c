// SPDX-License-Identifier: MIT
// Changes of a room's scene: rotation and gain of lights, exposure, camera.
#include "control.h"

#include <math.h>
#include <string.h>

static const double degree = M_PI / 180;
static const double most_gain = 1e6, most_ev = 40; // that the daemon draws

static double number(const cJSON *json, const char *field, double missing)
{
    const cJSON *item = cJSON_GetObjectItemCaseSensitive(json, field);
    return cJSON_IsNumber(item) ? item->valuedouble : missing;
}

// Floats of the protocol: six digits are enough, and short.
static void set_number(cJSON *json, const char *field, double value)
{
    double kept = (double)(float)value;
    cJSON *item = cJSON_GetObjectItemCaseSensitive(json, field);
    if (item) cJSON_SetNumberValue(item, kept);
    else cJSON_AddNumberToObject(json, field, kept);
}

static cJSON *object_of(cJSON *json, const char *field)
{
    cJSON *item = cJSON_GetObjectItemCaseSensitive(json, field);
    if (cJSON_IsObject(item)) return item;
    cJSON_DeleteItemFromObjectCaseSensitive(json, field);
    return cJSON_AddObjectToObject(json, field);
}

static bool touches(const struct change *c, enum target t)
{
    return c->has_position[t] || c->delta[t] != 0;
}

static double clamp(double x, double low, double high)
{
    return fmin(fmax(x, low), high);
}

static double turned(double degrees)
{
    return remainder(degrees, 360);
}

// ---- lights

static void change_gain(cJSON *light, const cJSON *base, const struct change *c)
{
    static const char *const axis[] = {"x", "y", "z"};
    const cJSON *from = c->has_position[TARGET_LIGHT_GAIN] ? base : light;
    const cJSON *was = cJSON_GetObjectItemCaseSensitive(from, "gain");
    double stops = c->position[TARGET_LIGHT_GAIN] + c->delta[TARGET_LIGHT_GAIN];
    double gain[3];
    for (int i = 0; i < 3; i++)
        gain[i] = clamp((was ? number(was, axis[i], 0) : 1) * exp2(stops), 0, most_gain);
    cJSON *out = object_of(light, "gain");
    for (int i = 0; i < 3; i++) set_number(out, axis[i], gain[i]);
}

static void change_light(cJSON *light, const cJSON *base, const struct change *c)
{
    if (touches(c, TARGET_LIGHT_AZIMUTH)) {
        bool anew = c->has_position[TARGET_LIGHT_AZIMUTH];
        double angle = number(anew ? base : light, "rotate_deg", 0);
        angle += c->position[TARGET_LIGHT_AZIMUTH] + c->delta[TARGET_LIGHT_AZIMUTH];
        set_number(light, "rotate_deg", turned(angle));
    }
    if (touches(c, TARGET_LIGHT_GAIN)) change_gain(light, base, c);
}

static bool change_lights(cJSON *scene, const cJSON *base, const struct change *c, int which)
{
    cJSON *lights = cJSON_GetObjectItemCaseSensitive(scene, "lights"), *light;
    const cJSON *before = cJSON_GetObjectItemCaseSensitive(base, "lights");
    bool any = false;
    int i = 0;
    if (!touches(c, TARGET_LIGHT_AZIMUTH) && !touches(c, TARGET_LIGHT_GAIN)) return false;
    cJSON_ArrayForEach(light, lights)
    {
        if (which < 0 || which == i) {
            const cJSON *was = cJSON_GetArrayItem(before, i);
            change_light(light, was ? was : light, c);
            any = true;
        }
        i++;
    }
    return any;
}

// ---- camera

static void read_vec(const cJSON *json, const char *field, const double missing[3],
                     double out[3])
{
    static const char *const axis[] = {"x", "y", "z"};
    const cJSON *v = cJSON_GetObjectItemCaseSensitive(json, field);
    for (int i = 0; i < 3; i++) out[i] = v ? number(v, axis[i], 0) : missing[i];
}

static double dot(const double a[3], const double b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

// x in multiples of unit vectors: its part along up, and the rest in the plane, rotated about
// up and lifted towards it. Angles in radians.
static void orbit_about(double offset[3], const double up[3], double azimuth, double elevation)
{
    double length = sqrt(dot(offset, offset)), along = dot(offset, up), flat[3], side[3];
    for (int i = 0; i < 3; i++) flat[i] = offset[i] - along * up[i];
    double size = sqrt(dot(flat, flat));
    if (!(length > 0) || !(size > 1e-9 * length)) return; // straight from above
    for (int i = 0; i < 3; i++) flat[i] /= size;
    for (int i = 0; i < 3; i++)
        side[i] = up[(i + 1) % 3] * flat[(i + 2) % 3] - up[(i + 2) % 3] * flat[(i + 1) % 3];
    double height = clamp(atan2(along, size) + elevation, -89 * degree, 89 * degree);
    for (int i = 0; i < 3; i++)
        offset[i] = length * (cos(height) * (cos(azimuth) * flat[i] + sin(azimuth) * side[i]) +
                              sin(height) * up[i]);
}

static void turn_eye(cJSON *camera, double azimuth, double elevation, double zoom)
{
    static const char *const axis[] = {"x", "y", "z"};
    static const double none[3] = {0, 0, 0}, y[3] = {0, 1, 0};
    double eye[3], target[3], up[3];
    read_vec(camera, "eye", none, eye);
    read_vec(camera, "target", none, target);
    read_vec(camera, "up", y, up);
    double size = sqrt(dot(up, up));
    if (!(size > 0)) return;
    for (int i = 0; i < 3; i++) up[i] /= size;
    for (int i = 0; i < 3; i++) eye[i] -= target[i];
    orbit_about(eye, up, azimuth * degree, elevation * degree);
    cJSON *out = object_of(camera, "eye");
    for (int i = 0; i < 3; i++) set_number(out, axis[i], target[i] + eye[i] * exp2(-zoom));
}

static void turn_orbit(cJSON *camera, double azimuth, double elevation, double zoom)
{
    cJSON *orbit = object_of(camera, "orbit");
    double was = number(orbit, "zoom", 1);
    cJSON_DeleteItemFromObjectCaseSensitive(camera, "name");
    set_number(orbit, "azimuth_deg", turned(number(orbit, "azimuth_deg", 0) + azimuth));
    set_number(orbit, "elevation_deg",
               clamp(number(orbit, "elevation_deg", 0) + elevation, -90, 90));
    set_number(orbit, "zoom", clamp((was > 0 ? was : 1) * exp2(zoom), .1, 100));
}

static bool is_eye(const cJSON *camera)
{
    return cJSON_HasObjectItem(camera, "eye") && !cJSON_HasObjectItem(camera, "orbit");
}

static void turn_camera(cJSON *camera, const double by[3])
{
    (is_eye(camera) ? turn_eye : turn_orbit)(camera, by[0], by[1], by[2]);
}

// How far camera is turned from base, in the units of turn_camera; zeros where they differ in
// kind.
static void turned_from(const cJSON *camera, const cJSON *base, double out[3])
{
    static const double none[3] = {0, 0, 0}, y[3] = {0, 1, 0};
    const cJSON *json[2] = {base, camera};
    double pose[2][3], flat[2][3], up[3], side[3];
    out[0] = out[1] = out[2] = 0;
    if (is_eye(camera) != is_eye(base)) return;
    read_vec(base, "up", y, up);
    double size = sqrt(dot(up, up));
    if (!(size > 0)) return;
    for (int k = 0; k < 2; k++) {
        const cJSON *orbit = cJSON_GetObjectItemCaseSensitive(json[k], "orbit");
        double eye[3], target[3], zoom = number(orbit, "zoom", 1), along = 0;
        read_vec(json[k], "eye", none, eye);
        read_vec(json[k], "target", none, target);
        for (int i = 0; i < 3; i++) along += (eye[i] - target[i]) * up[i] / size;
        for (int i = 0; i < 3; i++) flat[k][i] = eye[i] - target[i] - along * up[i] / size;
        double width = sqrt(dot(flat[k], flat[k]));
        pose[k][0] = number(orbit, "azimuth_deg", 0);
        pose[k][1] = number(orbit, "elevation_deg", 0);
        pose[k][2] = log2(zoom > 0 ? zoom : 1);
        if (!is_eye(base)) continue;
        if (!(width > 0)) return;
        pose[k][1] = atan2(along, width) / degree;
        pose[k][2] = -log2(hypot(along, width));
    }
    for (int i = 0; i < 3; i++) out[i] = pose[1][i] - pose[0][i];
    if (!is_eye(base)) return;
    for (int i = 0; i < 3; i++)
        side[i] = flat[0][(i + 1) % 3] * flat[1][(i + 2) % 3] -
                  flat[0][(i + 2) % 3] * flat[1][(i + 1) % 3];
    out[0] = atan2(dot(side, up) / size, dot(flat[0], flat[1])) / degree;
}

// A slider's axis counts from the first camera; the other axes stay as they are.
static bool change_camera(cJSON *scene, const cJSON *base, const struct change *c)
{
    const cJSON *first = cJSON_GetObjectItemCaseSensitive(base, "camera");
    double by[3], kept[3];
    bool any = false, anew = false;
    turned_from(cJSON_GetObjectItemCaseSensitive(scene, "camera"), first, kept);
    for (int i = 0; i < 3; i++) {
        enum target t = (enum target)(TARGET_CAMERA_AZIMUTH + i);
        any |= touches(c, t);
        anew |= c->has_position[t];
        if (c->has_position[t]) kept[i] = 0;
        by[i] = c->position[t] + c->delta[t];
    }
    if (!any) return false;
    if (anew) {
        cJSON *was = cJSON_Duplicate(first, 1);
        cJSON_DeleteItemFromObjectCaseSensitive(scene, "camera");
        if (was) cJSON_AddItemToObject(scene, "camera", was);
        for (int i = 0; i < 3; i++) by[i] += kept[i];
    }
    turn_camera(object_of(scene, "camera"), by);
    return true;
}

// ---- the scene

static bool change_exposure(cJSON *scene, const cJSON *base, const struct change *c)
{
    if (!touches(c, TARGET_EXPOSURE)) return false;
    cJSON *picture = object_of(scene, "picture");
    const cJSON *was = cJSON_GetObjectItemCaseSensitive(base, "picture");
    double ev = number(c->has_position[TARGET_EXPOSURE] ? was : picture, "exposure_ev", 0);
    ev += c->position[TARGET_EXPOSURE] + c->delta[TARGET_EXPOSURE];
    set_number(picture, "exposure_ev", clamp(ev, -most_ev, most_ev));
    return true;
}

static void put_back(cJSON *scene, const cJSON *base, const char *part)
{
    cJSON *was = cJSON_Duplicate(cJSON_GetObjectItemCaseSensitive(base, part), 1);
    cJSON_DeleteItemFromObjectCaseSensitive(scene, part);
    if (was) cJSON_AddItemToObject(scene, part, was);
}

bool scene_change(cJSON *scene, const cJSON *base, const struct change *c, int light,
                  cJSON *parts)
{
    static const char *const names[] = {"lights", "picture", "camera"};
    bool changed[3] = {c->reset, c->reset, c->reset}, any = c->reset;
    for (int i = 0; i < 3 && c->reset; i++) put_back(scene, base, names[i]);
    changed[0] |= change_lights(scene, base, c, light);
    changed[1] |= change_exposure(scene, base, c);
    changed[2] |= change_camera(scene, base, c);
    for (int i = 0; i < 3; i++) {
        any |= changed[i];
        if (changed[i]) cJSON_AddItemToArray(parts, cJSON_CreateString(names[i]));
    }
    return any;
}
