// SPDX-License-Identifier: MIT
// An input that another program's material leaves out has the default of its format: the medium
// is the same where the default is written.
#include "prt/medium.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>

#include <cmocka.h>

static struct prt_context context;

static struct prt_material medium(const char *text)
{
    struct prt_import *item;
    unsigned n = 0;
    assert_int_equal(prt_material_import(&context, "text", text, strlen(text), 0, &item, &n),
                     PRT_OK);
    assert_int_equal(n, 1);
    if (!item->has_medium) fail_msg("%s: %s", text, item->why_not);
    struct prt_material m = item->material;
    prt_free(item);
    return m;
}

static void same(const char *one, const char *other)
{
    const struct prt_material a = medium(one), b = medium(other);
    for (int c = 0; c < 3; c++) {
        assert_float_equal(a.sigma_s_prime[c], b.sigma_s_prime[c], 1e-6 * a.sigma_s_prime[c]);
        assert_float_equal(a.sigma_a[c], b.sigma_a[c], 1e-6 * a.sigma_a[c]);
        assert_float_equal(a.g[c], b.g[c], 1e-6);
    }
    assert_float_equal(a.eta, b.eta, 1e-6);
    assert_float_equal(a.roughness, b.roughness, 1e-6);
}

// Blender 4 has a scale beside the radius; in 2 and 3 "subsurface" is the weight and the radius
// the path. Of an input under both names the newer counts.
static void blender(void **state)
{
    same("{\"Subsurface Weight\":1}",
         "{\"Subsurface Weight\":1,\"Base Color\":[0.8,0.8,0.8,1],\"Subsurface Radius\":"
         "[1,0.2,0.1],\"Subsurface Scale\":0.05,\"IOR\":1.5,\"Roughness\":0.5,"
         "\"Specular IOR Level\":0.5,\"Subsurface Anisotropy\":0}");
    same("{\"Subsurface\":1}",
         "{\"Subsurface\":1,\"Base Color\":[0.8,0.8,0.8,1],\"Subsurface Color\":[0.8,0.8,0.8],"
         "\"Subsurface Radius\":[1,0.2,0.1],\"Subsurface Scale\":1,\"IOR\":1.45,"
         "\"Roughness\":0.5,\"Specular\":0.5}");
    same("{\"Subsurface Weight\":1,\"Specular IOR Level\":0.2}",
         "{\"Subsurface Weight\":1,\"Specular IOR Level\":0.2,\"Specular\":0.9}");
}

static const char *mtlx(char text[2000], const char *shader, const char *inputs)
{
    snprintf(text, 2000,
             "<materialx version=\"1.38\"><%s name=\"s\" type=\"surfaceshader\">%s</%s>"
             "</materialx>",
             shader, inputs, shader);
    return text;
}

#define NUMBER(name, value) "<input name=\"" name "\" type=\"float\" value=\"" value "\"/>"
#define COLOR(name, value) "<input name=\"" name "\" type=\"color3\" value=\"" value "\"/>"

static void material_x(void **state)
{
    char a[2000], b[2000];
    same(mtlx(a, "open_pbr_surface", NUMBER("subsurface_weight", "1")),
         mtlx(b, "open_pbr_surface",
              NUMBER("subsurface_weight", "1") COLOR("subsurface_color", "0.8, 0.8, 0.8")
                  NUMBER("subsurface_radius", "1")
                      COLOR("subsurface_radius_scale", "1, 0.5, 0.25")
                          NUMBER("specular_roughness", "0.3") NUMBER("specular_ior", "1.5")));
    same(mtlx(a, "standard_surface", NUMBER("subsurface", "1")),
         mtlx(b, "standard_surface",
              NUMBER("subsurface", "1") COLOR("subsurface_color", "1, 1, 1")
                  COLOR("subsurface_radius", "1, 1, 1") NUMBER("subsurface_scale", "1")
                      NUMBER("specular_roughness", "0.2") NUMBER("specular_IOR", "1.5")));
    // half of an interior: the rest is the base
    same(mtlx(a, "open_pbr_surface",
              NUMBER("subsurface_weight", "0.5") COLOR("base_color", "0.4, 0.2, 0.1")),
         mtlx(b, "open_pbr_surface",
              NUMBER("subsurface_weight", "0.5") COLOR("base_color", "0.8, 0.4, 0.2")
                  NUMBER("base_weight", "0.5")));
}

// A scale multiplies a preset as it does coefficients.
static void pbrt(void **state)
{
    const struct prt_material
        one = medium("MakeNamedMedium \"m\" \"string type\" \"homogeneous\" \"string preset\" "
                     "\"Skin1\""),
        two = medium("MakeNamedMedium \"m\" \"string type\" \"homogeneous\" \"string preset\" "
                     "\"Skin1\" \"float scale\" [2]");
    for (int c = 0; c < 3; c++) {
        assert_float_equal(two.sigma_s_prime[c], 2 * one.sigma_s_prime[c], 1e-5);
        assert_float_equal(two.sigma_a[c], 2 * one.sigma_a[c], 1e-5);
    }
    same("Material \"subsurface\"",
         "Material \"subsurface\" \"rgb sigma_a\" [0.0011 0.0024 0.014] \"rgb sigma_s\" "
         "[2.55 3.21 3.77] \"float eta\" 1.33 \"float g\" 0 \"float scale\" 1 \"float "
         "roughness\" 0");
}

static void ignore(void *user, enum prt_log_level level, const char *line)
{
}

int main(void)
{
    prt_context_init(&context);
    context.log = ignore;
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(blender),
        cmocka_unit_test(material_x),
        cmocka_unit_test(pbrt),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
