// SPDX-License-Identifier: MIT
// Pictures whose camera the daemon places: an orbit, a camera of the model's file; models by a
// beginning of their name. Before the bake and after it.
#include "../data.h"
#include "ball.h"

// A tetrahedron of one unit with two cameras.
static const char gltf[] =
    "{\"asset\":{\"version\":\"2.0\"},\"scenes\":[{\"nodes\":[0,1,2]}],\"nodes\":[{\"mesh\":0},"
    "{\"name\":\"Front view\",\"camera\":0,\"translation\":[0.3,0.3,4]},"
    "{\"name\":\"Side\",\"camera\":0,\"translation\":[4,0.3,0.3],"
    "\"rotation\":[0,0.70710678,0,0.70710678]}],"
    "\"cameras\":[{\"type\":\"perspective\",\"perspective\":{\"yfov\":0.5,\"znear\":0.1}}],"
    "\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0},\"indices\":1}]}],"
    "\"accessors\":[{\"bufferView\":0,\"componentType\":5126,\"count\":4,\"type\":\"VEC3\"},"
    "{\"bufferView\":1,\"componentType\":5123,\"count\":12,\"type\":\"SCALAR\"}],"
    "\"bufferViews\":[{\"buffer\":0,\"byteLength\":48},"
    "{\"buffer\":0,\"byteOffset\":48,\"byteLength\":24}],"
    "\"buffers\":[{\"byteLength\":72,\"uri\":\"data:application/octet-stream;base64,"
    "AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAAAAAAAAAAAAAAAIA/"
    "AAACAAEAAAABAAMAAAADAAIAAQACAAMA\"}]}";

static char model[ID_SIZE];

static void load(struct relight_load how, const char *name, char id[ID_SIZE])
{
    char path[160];
    struct relight_loaded loaded;
    snprintf(path, sizeof path, "%s/%s", d.folder, name);
    FILE *f = fopen(path, "w");
    assert_non_null(f);
    fputs(gltf, f);
    fclose(f);
    OK(relight_load_file(client, path, &how, NULL, NULL, &loaded, &error));
    snprintf(id, ID_SIZE, "%s", loaded.model);
    if (loaded.job[0]) OK(relight_watch(client, loaded.job, NULL, NULL, &error));
    relight_loaded_finish(&loaded);
}

static void seen_from(const char *text, bool orbit, float x, float y, float z)
{
    struct relight_image_request r = request_of(model, 0);
    struct relight_image image;
    if (orbit) OK(relight_orbit_parse(text, &r.picture.camera, &error));
    else OK(relight_camera_parse(text, &r.picture.camera, &error));
    OK(relight_image(client, &r, &image, &error));
    const float *eye = image.camera.eye, *target = image.camera.target;
    const float want[3] = {x, y, z};
    double length = 0, along = 0;
    for (int k = 0; k < 3; k++) {
        double to = (double)eye[k] - target[k];
        length += to * to;
        along += to * want[k];
    }
    if (along / sqrt(length) < 0.9999)
        fail_msg("%s: eye %g,%g,%g", text, eye[0], eye[1], eye[2]);
    relight_image_finish(&image);
}

static void refused(const struct relight_camera *camera, int code, const char *said)
{
    struct relight_image_request r = request_of(model, 0);
    struct relight_image image;
    r.picture.camera = *camera;
    expect(relight_image(client, &r, &image, &error), code, said);
    if (!strstr(error.text, said)) fail_msg("said: %s", error.text);
}

static void check_views(void)
{
    struct relight_model m;
    OK(relight_info(client, model, &m, &error));
    assert_int_equal(m.n_camera, 2);
    assert_string_equal(m.camera[0].name, "Front view");
    assert_true(m.camera[1].eye[0] == 4);
    relight_model_finish(&m);
    seen_from("fr", false, 0, 0, 1);
    seen_from("Side", false, 1, 0, 0);
    seen_from("90,0", true, 1, 0, 0);
    seen_from("180,0,2", true, 0, 0, -1);
    seen_from("0,90", true, 0, 1, 0);
    struct relight_camera c = {.set = true, .name = "Syde"};
    refused(&c, RELIGHT_E_OUT_OF_RANGE, "did you mean Side?");
    c = (struct relight_camera){.set = true, .has_orbit = true, .elevation_deg = 91};
    refused(&c, RELIGHT_E_OUT_OF_RANGE, "elevation");
    c = (struct relight_camera){.set = true, .has_orbit = true, .zoom = NAN};
    refused(&c, RELIGHT_E_OUT_OF_RANGE, "zoom");
    c = (struct relight_camera){.set = true, .has_orbit = true, .name = "Side"};
    refused(&c, RELIGHT_E_BAD_REQUEST, "or orbit");
}

static void views_of_a_preview(void **state)
{
    load(small_load(true), "pyramid.gltf", model);
    check_views();
}

static void views_of_a_bake(void **state)
{
    load(small_load(false), "pyramid.gltf", model);
    check_views();
}

static void a_model_with_z_up(void **state)
{
    struct relight_load how = small_load(true);
    char turned[ID_SIZE];
    struct relight_model m;
    how.up_z = true;
    load(how, "pyramid.gltf", turned);
    assert_string_not_equal(turned, model);
    OK(relight_info(client, turned, &m, &error));
    assert_true(m.camera[0].eye[1] == 4 && fabsf(m.camera[0].eye[2] + 0.3f) < 1e-6f);
    relight_model_finish(&m);
    OK(relight_unload(client, turned, true, NULL, &error));
}

static void models_by_a_beginning(void **state)
{
    struct relight_model m;
    OK(relight_info(client, "pyr", &m, &error));
    assert_string_equal(m.id, model);
    relight_model_finish(&m);
    expect(relight_info(client, "pyramyd", &m, &error), RELIGHT_E_NOT_FOUND,
           "did you mean pyramid.gltf?");
    char second[ID_SIZE];
    struct relight_load how = small_load(true);
    how.material = "marble";
    load(how, "pyramid_2.gltf", second);
    expect(relight_info(client, "pyr", &m, &error), RELIGHT_E_NOT_FOUND, "pyramid_2.gltf");
    OK(relight_info(client, "pyramid_", &m, &error));
    assert_string_equal(m.id, second);
    relight_model_finish(&m);
    struct relight_image_request r = request_of(model, 0);
    struct relight_image image;
    r.model = second;
    r.shade.material = "marbel";
    expect(relight_image(client, &r, &image, &error), RELIGHT_E_OUT_OF_RANGE,
           "did you mean marble?");
    r.shade.material = "skimm";
    OK(relight_image(client, &r, &image, &error));
    relight_image_finish(&image);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(views_of_a_preview),
        cmocka_unit_test(views_of_a_bake),
        cmocka_unit_test(models_by_a_beginning),
        cmocka_unit_test(a_model_with_z_up),
    };
    return run_test_group(tests, ball_setup, ball_teardown);
}
