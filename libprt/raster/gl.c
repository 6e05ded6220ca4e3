// SPDX-License-Identifier: MIT
// The GL driver: loaded with dlopen, one context for each backend and process, draws triangle
// numbers.
#include "internal.h"

#include <EGL/egl.h>
#include <EGL/eglext.h>
#include <GL/glcorearb.h>
#include <dlfcn.h>
#include <pthread.h>
#include <stdio.h>
#include <string.h>

#define GL_FUNCTIONS(X)                                            \
    X(PFNGLGETSTRINGPROC, GetString)                               \
    X(PFNGLGETINTEGERVPROC, GetIntegerv)                           \
    X(PFNGLGETERRORPROC, GetError)                                 \
    X(PFNGLCREATESHADERPROC, CreateShader)                         \
    X(PFNGLSHADERSOURCEPROC, ShaderSource)                         \
    X(PFNGLCOMPILESHADERPROC, CompileShader)                       \
    X(PFNGLGETSHADERIVPROC, GetShaderiv)                           \
    X(PFNGLGETSHADERINFOLOGPROC, GetShaderInfoLog)                 \
    X(PFNGLDELETESHADERPROC, DeleteShader)                         \
    X(PFNGLCREATEPROGRAMPROC, CreateProgram)                       \
    X(PFNGLATTACHSHADERPROC, AttachShader)                         \
    X(PFNGLLINKPROGRAMPROC, LinkProgram)                           \
    X(PFNGLGETPROGRAMIVPROC, GetProgramiv)                         \
    X(PFNGLUSEPROGRAMPROC, UseProgram)                             \
    X(PFNGLUNIFORM3FPROC, Uniform3f)                               \
    X(PFNGLUNIFORM1IPROC, Uniform1i)                               \
    X(PFNGLUNIFORMMATRIX4FVPROC, UniformMatrix4fv)                 \
    X(PFNGLGENVERTEXARRAYSPROC, GenVertexArrays)                   \
    X(PFNGLBINDVERTEXARRAYPROC, BindVertexArray)                   \
    X(PFNGLGENBUFFERSPROC, GenBuffers)                             \
    X(PFNGLDELETEBUFFERSPROC, DeleteBuffers)                       \
    X(PFNGLBINDBUFFERPROC, BindBuffer)                             \
    X(PFNGLBUFFERDATAPROC, BufferData)                             \
    X(PFNGLVERTEXATTRIBPOINTERPROC, VertexAttribPointer)           \
    X(PFNGLENABLEVERTEXATTRIBARRAYPROC, EnableVertexAttribArray)   \
    X(PFNGLDISABLEVERTEXATTRIBARRAYPROC, DisableVertexAttribArray) \
    X(PFNGLGENTEXTURESPROC, GenTextures)                           \
    X(PFNGLDELETETEXTURESPROC, DeleteTextures)                     \
    X(PFNGLBINDTEXTUREPROC, BindTexture)                           \
    X(PFNGLTEXSTORAGE2DPROC, TexStorage2D)                         \
    X(PFNGLTEXSTORAGE2DMULTISAMPLEPROC, TexStorage2DMultisample)   \
    X(PFNGLGENFRAMEBUFFERSPROC, GenFramebuffers)                   \
    X(PFNGLBINDFRAMEBUFFERPROC, BindFramebuffer)                   \
    X(PFNGLFRAMEBUFFERTEXTUREPROC, FramebufferTexture)             \
    X(PFNGLCHECKFRAMEBUFFERSTATUSPROC, CheckFramebufferStatus)     \
    X(PFNGLDELETEFRAMEBUFFERSPROC, DeleteFramebuffers)             \
    X(PFNGLGETMULTISAMPLEFVPROC, GetMultisamplefv)                 \
    X(PFNGLVIEWPORTPROC, Viewport)                                 \
    X(PFNGLENABLEPROC, Enable)                                     \
    X(PFNGLDISABLEPROC, Disable)                                   \
    X(PFNGLDEPTHFUNCPROC, DepthFunc)                               \
    X(PFNGLCLIPCONTROLPROC, ClipControl)                           \
    X(PFNGLCLEARBUFFERUIVPROC, ClearBufferuiv)                     \
    X(PFNGLCLEARBUFFERFVPROC, ClearBufferfv)                       \
    X(PFNGLDRAWELEMENTSPROC, DrawElements)                         \
    X(PFNGLDRAWARRAYSPROC, DrawArrays)                             \
    X(PFNGLPIXELSTOREIPROC, PixelStorei)                           \
    X(PFNGLREADPIXELSPROC, ReadPixels)

struct gl {
#define X(type, name) type name;
    GL_FUNCTIONS(X)
#undef X
};

// One driver with its context and the objects kept between calls.
struct driver {
    pthread_mutex_t lock;
    int state;     // 0 untried, 1 usable, -1 missing
    char why[160]; // the reason of -1
    struct gl gl;
    void *context;
    // OSMesa
    unsigned char (*osmesa_make_current)(void *, void *, unsigned, int, int);
    unsigned char osmesa_pixels[16 * 16 * 4];
    // EGL
    EGLDisplay display;
    EGLBoolean (*egl_make_current)(EGLDisplay, EGLSurface, EGLSurface, EGLContext);
    // objects
    GLuint draw_program, resolve_program, vertex_array, buffer[2];
    GLint u_eye, u_clip;
};

static struct driver osmesa_driver = {.lock = PTHREAD_MUTEX_INITIALIZER};
static struct driver egl_driver = {.lock = PTHREAD_MUTEX_INITIALIZER};

typedef void *(*get_proc_fn)(const char *name);

static bool load_functions(struct driver *d, get_proc_fn get_proc)
{
#define X(type, name)                                                          \
    d->gl.name = (type)get_proc("gl" #name);                                   \
    if (!d->gl.name) {                                                         \
        snprintf(d->why, sizeof d->why, "GL function gl%s is missing", #name); \
        return false;                                                          \
    }
    GL_FUNCTIONS(X)
#undef X
    return true;
}

static bool make_current(struct driver *d, bool on)
{
    if (d == &osmesa_driver)
        return d->osmesa_make_current(on ? d->context : NULL, on ? d->osmesa_pixels : NULL,
                                      GL_UNSIGNED_BYTE, on ? 16 : 0, on ? 16 : 0) ||
               !on;
    return d->egl_make_current(d->display, EGL_NO_SURFACE, EGL_NO_SURFACE,
                               on ? d->context : EGL_NO_CONTEXT);
}

static bool open_osmesa(struct driver *d)
{
    void *lib = dlopen("libOSMesa.so.8", RTLD_NOW | RTLD_LOCAL);
    if (!lib) lib = dlopen("libOSMesa.so.6", RTLD_NOW | RTLD_LOCAL);
    if (!lib) {
        snprintf(d->why, sizeof d->why, "libOSMesa.so.8 cannot be loaded");
        return false;
    }
    void *(*create)(const int *, void *) =
        (void *(*)(const int *, void *))dlsym(lib, "OSMesaCreateContextAttribs");
    get_proc_fn get_proc = (get_proc_fn)dlsym(lib, "OSMesaGetProcAddress");
    d->osmesa_make_current =
        (unsigned char (*)(void *, void *, unsigned, int, int))dlsym(lib, "OSMesaMakeCurrent");
    // OSMESA_FORMAT RGBA, no depth of its own, PROFILE core, version 4.5
    static const int attributes[] = {0x22, GL_RGBA, 0x30, 0, 0x31, 0, 0x32, 0,
                                     0x33, 0x34,    0x36, 4, 0x37, 5, 0};
    if (create && get_proc && d->osmesa_make_current) d->context = create(attributes, NULL);
    if (!d->context) {
        snprintf(d->why, sizeof d->why, "OSMesa gives no OpenGL 4.5 core context");
        return false;
    }
    return load_functions(d, get_proc);
}

static bool open_egl(struct driver *d)
{
    void *lib = dlopen("libEGL.so.1", RTLD_NOW | RTLD_LOCAL);
    if (!lib) {
        snprintf(d->why, sizeof d->why, "libEGL.so.1 cannot be loaded");
        return false;
    }
    PFNEGLGETPROCADDRESSPROC get = (PFNEGLGETPROCADDRESSPROC)dlsym(lib, "eglGetProcAddress");
    PFNEGLINITIALIZEPROC initialize = (PFNEGLINITIALIZEPROC)dlsym(lib, "eglInitialize");
    PFNEGLBINDAPIPROC bind_api = (PFNEGLBINDAPIPROC)dlsym(lib, "eglBindAPI");
    PFNEGLCREATECONTEXTPROC create = (PFNEGLCREATECONTEXTPROC)dlsym(lib, "eglCreateContext");
    d->egl_make_current = (PFNEGLMAKECURRENTPROC)dlsym(lib, "eglMakeCurrent");
    PFNEGLGETPLATFORMDISPLAYEXTPROC get_display = NULL;
    if (get) get_display = (PFNEGLGETPLATFORMDISPLAYEXTPROC)get("eglGetPlatformDisplayEXT");
    if (!get_display || !initialize || !bind_api || !create || !d->egl_make_current) {
        snprintf(d->why, sizeof d->why, "libEGL.so.1 lacks eglGetPlatformDisplayEXT");
        return false;
    }
    d->display = get_display(EGL_PLATFORM_SURFACELESS_MESA, EGL_DEFAULT_DISPLAY, NULL);
    if (!d->display || !initialize(d->display, NULL, NULL) || !bind_api(EGL_OPENGL_API)) {
        snprintf(d->why, sizeof d->why, "EGL has no surfaceless display");
        return false;
    }
    static const EGLint attributes[] = {EGL_CONTEXT_MAJOR_VERSION,
                                        4,
                                        EGL_CONTEXT_MINOR_VERSION,
                                        5,
                                        EGL_CONTEXT_OPENGL_PROFILE_MASK,
                                        EGL_CONTEXT_OPENGL_CORE_PROFILE_BIT,
                                        EGL_NONE};
    d->context = create(d->display, (EGLConfig)0, EGL_NO_CONTEXT, attributes);
    if (!d->context) {
        snprintf(d->why, sizeof d->why, "EGL gives no OpenGL 4.5 core context");
        return false;
    }
    return load_functions(d, (get_proc_fn)get);
}

// The eye is subtracted before the matrix is applied, so that a scene far from the origin keeps
// the single precision of its positions.
static const char draw_vertex[] =
    "#version 450 core\n"
    "layout(location=0) in vec3 position;\n"
    "layout(location=0) uniform vec3 eye;\n"
    "layout(location=1) uniform mat4 clip;\n"
    "void main() { gl_Position = clip*vec4(position - eye, 1); }\n";
static const char draw_fragment[] = "#version 450 core\n"
                                    "layout(location=0) out uint id;\n"
                                    "void main() { id = uint(gl_PrimitiveID); }\n";
static const char resolve_vertex[] =
    "#version 450 core\n"
    "void main() { gl_Position = vec4(gl_VertexID == 1 ? 3.0 : -1.0,\n"
    "                                 gl_VertexID == 2 ? 3.0 : -1.0, 0.5, 1); }\n";
static const char resolve_fragment[] =
    "#version 450 core\n"
    "layout(location=0) out uvec4 id;\n"
    "layout(location=0) uniform usampler2DMS ids;\n"
    "void main() { ivec2 p = ivec2(gl_FragCoord.xy);\n"
    "  id = uvec4(texelFetch(ids,p,0).r, texelFetch(ids,p,1).r,\n"
    "             texelFetch(ids,p,2).r, texelFetch(ids,p,3).r); }\n";

static GLuint build_program(struct driver *d, const char *vertex, const char *fragment)
{
    const struct gl *gl = &d->gl;
    GLuint program = gl->CreateProgram();
    const char *source[2] = {vertex, fragment};
    static const GLenum kind[2] = {GL_VERTEX_SHADER, GL_FRAGMENT_SHADER};
    GLint good = 0;
    for (int i = 0; i < 2; i++) {
        GLuint shader = gl->CreateShader(kind[i]);
        gl->ShaderSource(shader, 1, &source[i], NULL);
        gl->CompileShader(shader);
        gl->GetShaderiv(shader, GL_COMPILE_STATUS, &good);
        if (!good) {
            char text[100] = "";
            gl->GetShaderInfoLog(shader, sizeof text, NULL, text);
            snprintf(d->why, sizeof d->why, "shader: %s", text);
            return 0;
        }
        gl->AttachShader(program, shader);
        gl->DeleteShader(shader);
    }
    gl->LinkProgram(program);
    gl->GetProgramiv(program, GL_LINK_STATUS, &good);
    if (!good) snprintf(d->why, sizeof d->why, "shaders do not link");
    return good ? program : 0;
}

static bool build_objects(struct driver *d)
{
    const struct gl *gl = &d->gl;
    d->draw_program = build_program(d, draw_vertex, draw_fragment);
    d->resolve_program = build_program(d, resolve_vertex, resolve_fragment);
    if (!d->draw_program || !d->resolve_program) return false;
    gl->GenVertexArrays(1, &d->vertex_array);
    gl->ClipControl(GL_LOWER_LEFT, GL_ZERO_TO_ONE);
    gl->DepthFunc(GL_GREATER); // reversed depth in float has even precision over the range
    gl->PixelStorei(GL_PACK_ALIGNMENT, 4);
    return true;
}

// Opens the driver on first use. Its lock must be held.
static bool driver_ready(struct driver *d)
{
    if (d->state == 0) {
        bool good = d == &osmesa_driver ? open_osmesa(d) : open_egl(d);
        if (good && !make_current(d, true)) {
            snprintf(d->why, sizeof d->why, "the context cannot be made current");
            good = false;
        }
        if (good) {
            good = build_objects(d);
            make_current(d, false);
        }
        d->state = good ? 1 : -1;
    }
    return d->state > 0;
}

struct targets {
    GLuint texture[3], framebuffer[2]; // ids, depth, resolved; draw, read
};

static bool make_targets(const struct gl *gl, uint32_t w, uint32_t h, unsigned n_sub,
                         struct targets *t)
{
    gl->GenTextures(3, t->texture);
    gl->GenFramebuffers(2, t->framebuffer);
    GLenum kind = n_sub > 1 ? GL_TEXTURE_2D_MULTISAMPLE : GL_TEXTURE_2D;
    static const GLenum format[2] = {GL_R32UI, GL_DEPTH_COMPONENT32F};
    static const GLenum where[2] = {GL_COLOR_ATTACHMENT0, GL_DEPTH_ATTACHMENT};
    gl->BindFramebuffer(GL_FRAMEBUFFER, t->framebuffer[0]);
    for (int i = 0; i < 2; i++) {
        gl->BindTexture(kind, t->texture[i]);
        if (n_sub > 1)
            gl->TexStorage2DMultisample(kind, (GLsizei)n_sub, format[i], (GLsizei)w, (GLsizei)h,
                                        GL_TRUE);
        else gl->TexStorage2D(kind, 1, format[i], (GLsizei)w, (GLsizei)h);
        gl->FramebufferTexture(GL_FRAMEBUFFER, where[i], t->texture[i], 0);
    }
    bool good = gl->CheckFramebufferStatus(GL_FRAMEBUFFER) == GL_FRAMEBUFFER_COMPLETE;
    if (n_sub > 1) {
        gl->BindTexture(GL_TEXTURE_2D, t->texture[2]);
        gl->TexStorage2D(GL_TEXTURE_2D, 1, GL_RGBA32UI, (GLsizei)w, (GLsizei)h);
        gl->BindFramebuffer(GL_FRAMEBUFFER, t->framebuffer[1]);
        gl->FramebufferTexture(GL_FRAMEBUFFER, GL_COLOR_ATTACHMENT0, t->texture[2], 0);
        good &= gl->CheckFramebufferStatus(GL_FRAMEBUFFER) == GL_FRAMEBUFFER_COMPLETE;
        gl->BindFramebuffer(GL_FRAMEBUFFER, t->framebuffer[0]);
    }
    return good;
}

// The clip matrix for positions relative to the eye: y down so that row 0 is on top, w the
// depth along the view, z reversed: 1 at z_near, 0 at z_far. shift moves the picture, in units
// of the clip square.
static void clip_matrix(const struct camera_frame *f, double z_near, double z_far,
                        const double shift[2], float m[16])
{
    double a = -z_near / (z_far - z_near), b = z_near * z_far / (z_far - z_near);
    for (int c = 0; c < 3; c++) {
        m[4 * c + 0] = (float)(f->right[c] / (f->tan_x * f->tan_x) + shift[0] * f->forward[c]);
        m[4 * c + 1] = (float)(-f->up[c] / (f->tan_y * f->tan_y) + shift[1] * f->forward[c]);
        m[4 * c + 2] = (float)(a * f->forward[c]);
        m[4 * c + 3] = (float)f->forward[c];
    }
    m[12] = m[13] = m[15] = 0;
    m[14] = (float)b;
}

static void upload_mesh(struct driver *d, const struct prt_mesh *mesh)
{
    const struct gl *gl = &d->gl;
    gl->BindVertexArray(d->vertex_array);
    gl->GenBuffers(2, d->buffer);
    gl->BindBuffer(GL_ARRAY_BUFFER, d->buffer[0]);
    gl->BufferData(GL_ARRAY_BUFFER, (GLsizeiptr)((size_t)mesh->n_vertex * 12), mesh->position,
                   GL_STREAM_DRAW);
    gl->BindBuffer(GL_ELEMENT_ARRAY_BUFFER, d->buffer[1]);
    gl->BufferData(GL_ELEMENT_ARRAY_BUFFER, (GLsizeiptr)((size_t)mesh->n_triangle * 12),
                   mesh->triangle, GL_STREAM_DRAW);
    gl->VertexAttribPointer(0, 3, GL_FLOAT, GL_FALSE, 12, NULL);
    gl->EnableVertexAttribArray(0);
}

// Sub-samples that one draw yields: 1, or 4 at the positions of the driver's multi-sampling.
// Other counts are drawn one sub-sample after another.
static unsigned samples_at_once(unsigned n_sub)
{
    return n_sub == 4 ? 4 : 1;
}

// Draws sub-samples [first, first + samples_at_once).
static void draw_band(struct driver *d, struct gl_draw *draw, const struct targets *t,
                      uint32_t row_begin, uint32_t rows, unsigned first, uint32_t *id)
{
    const struct gl *gl = &d->gl;
    GLsizei w = (GLsizei)draw->width, h = (GLsizei)rows;
    static const GLuint none[4] = {UINT32_MAX, 0, 0, 0};
    static const GLfloat far_depth = 0;
    float m[16];
    gl->BindFramebuffer(GL_FRAMEBUFFER, t->framebuffer[0]);
    gl->ClearBufferuiv(GL_COLOR, 0, none);
    gl->ClearBufferfv(GL_DEPTH, 0, &far_depth);
    gl->Viewport(0, -(GLint)row_begin, w, (GLsizei)draw->height);
    gl->Enable(GL_DEPTH_TEST);
    gl->UseProgram(d->draw_program);
    double shift[2] = {0, 0};
    if (samples_at_once(draw->n_sub) == 1) {
        shift[0] = 2 * (0.5 - (double)draw->sub_position[first][0]) / draw->width;
        shift[1] = 2 * (0.5 - (double)draw->sub_position[first][1]) / draw->height;
    }
    clip_matrix(draw->frame, draw->z_near, draw->z_far, shift, m);
    gl->Uniform3f(0, (float)draw->frame->eye[0], (float)draw->frame->eye[1],
                  (float)draw->frame->eye[2]);
    gl->UniformMatrix4fv(1, 1, GL_FALSE, m);
    gl->EnableVertexAttribArray(0);
    gl->DrawElements(GL_TRIANGLES, (GLsizei)(draw->mesh->n_triangle * 3), GL_UNSIGNED_INT,
                     NULL);
    bool several = samples_at_once(draw->n_sub) > 1;
    if (several) {
        gl->BindFramebuffer(GL_FRAMEBUFFER, t->framebuffer[1]);
        gl->Disable(GL_DEPTH_TEST);
        gl->DisableVertexAttribArray(0);
        gl->Viewport(0, 0, w, h);
        gl->UseProgram(d->resolve_program);
        gl->BindTexture(GL_TEXTURE_2D_MULTISAMPLE, t->texture[0]);
        gl->Uniform1i(0, 0);
        gl->DrawArrays(GL_TRIANGLES, 0, 3);
    }
    gl->ReadPixels(0, 0, w, h, several ? GL_RGBA_INTEGER : GL_RED_INTEGER, GL_UNSIGNED_INT, id);
}

// Positions in 1/16 pixel, as in Direct3D's standard patterns: no two in one column or row.
static const uint8_t two[2][2] = {{12, 12}, {4, 4}};
static const uint8_t eight[8][2] = {{9, 5},  {7, 11}, {13, 9},  {5, 3},
                                    {3, 13}, {1, 7},  {11, 15}, {15, 1}};

static void sub_positions(const struct gl *gl, struct gl_draw *draw)
{
    draw->sub_position[0][0] = draw->sub_position[0][1] = 0.5f;
    const uint8_t(*pattern)[2] = draw->n_sub == 2 ? two : eight;
    for (unsigned s = 0; s < draw->n_sub && draw->n_sub > 1; s++) {
        if (samples_at_once(draw->n_sub) > 1)
            gl->GetMultisamplefv(GL_SAMPLE_POSITION, s, draw->sub_position[s]);
        else
            for (int i = 0; i < 2; i++) draw->sub_position[s][i] = (float)pattern[s][i] / 16;
    }
}

// All sub-samples of a band, interleaved pixel by pixel. plane: scratch for one sub-sample.
static void draw_samples(struct driver *d, struct gl_draw *draw, const struct targets *t,
                         uint32_t row_begin, uint32_t rows, uint32_t *plane, uint32_t *id)
{
    if (samples_at_once(draw->n_sub) == draw->n_sub) {
        draw_band(d, draw, t, row_begin, rows, 0, id);
        return;
    }
    size_t n = (size_t)draw->width * rows;
    for (unsigned s = 0; s < draw->n_sub; s++) {
        draw_band(d, draw, t, row_begin, rows, s, plane);
        for (size_t i = 0; i < n; i++) id[i * draw->n_sub + s] = plane[i];
    }
}

// Errors that a call before left behind, such as a size that the driver refused.
static void forget_errors(const struct gl *gl)
{
    for (int i = 0; i < 16 && gl->GetError(); i++) continue;
}

static int draw_all(const struct prt_context *ctx, struct driver *d, struct gl_draw *draw)
{
    const struct gl *gl = &d->gl;
    forget_errors(gl);
    // bands of at most 4 Mi pixels bound the memory of multi-sampled targets; chosen, not
    // measured
    uint32_t band = (1u << 22) / draw->width;
    if (band > draw->height) band = draw->height;
    struct targets t;
    int status = PRT_OK;
    uint32_t *id = prt_alloc((size_t)draw->width * band * (draw->n_sub + 1), sizeof *id);
    uint32_t *plane = id + (size_t)draw->width * band * draw->n_sub;
    if (!id)
        return prt_fail(ctx, PRT_NOMEM, "raster: no memory for %ux%u pixels", draw->width,
                        draw->height);
    if (!make_targets(gl, draw->width, band, samples_at_once(draw->n_sub), &t))
        status = prt_fail(ctx, PRT_UNSUPPORTED,
                          "raster: the GL driver refuses %u-sample integer "
                          "targets of %ux%u",
                          samples_at_once(draw->n_sub), draw->width, band);
    upload_mesh(d, draw->mesh);
    sub_positions(gl, draw);
    for (uint32_t row = 0; !status && row < draw->height; row += band) {
        uint32_t rows = draw->height - row < band ? draw->height - row : band;
        // other threads' pictures wait for this one: a large one ends when nobody wants it
        status = row ? prt_progress(ctx, "visibility", (double)row / draw->height) : PRT_OK;
        if (status) break;
        draw_samples(d, draw, &t, row, rows, plane, id);
        GLenum error = gl->GetError();
        if (error)
            status = prt_fail(ctx, PRT_INTERNAL, "raster: GL error 0x%x while drawing", error);
        else status = draw->band(draw->user, row, row + rows, id);
    }
    gl->DeleteFramebuffers(2, t.framebuffer);
    gl->DeleteTextures(3, t.texture);
    gl->DeleteBuffers(2, d->buffer);
    prt_free(id);
    return status;
}

int prt_gl_draw_triangles(const struct prt_context *ctx, enum prt_raster_backend backend,
                          struct gl_draw *draw)
{
    struct driver *order[2] = {&osmesa_driver, &egl_driver};
    unsigned first = backend == PRT_RASTER_EGL, last = backend == PRT_RASTER_OSMESA ? 0 : 1;
    for (unsigned i = first; i <= last; i++) {
        struct driver *d = order[i];
        pthread_mutex_lock(&d->lock);
        if (driver_ready(d)) {
            int status = make_current(d, true)
                             ? draw_all(ctx, d, draw)
                             : prt_fail(ctx, PRT_INTERNAL,
                                        "raster: the GL context cannot be made current");
            make_current(d, false);
            pthread_mutex_unlock(&d->lock);
            return status;
        }
        pthread_mutex_unlock(&d->lock);
    }
    return prt_fail(ctx, PRT_UNSUPPORTED,
                    "raster: no off-screen OpenGL 4.5 (%s%s%s); install libosmesa6 or libegl1 "
                    "with libgl1-mesa-dri",
                    first ? "" : osmesa_driver.why, first || last == 0 ? "" : "; ",
                    last ? egl_driver.why : "");
}
