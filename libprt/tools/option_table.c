// SPDX-License-Identifier: MIT
// The options of every subcommand: names, values, ranges, help.
#include "options.h"
#include "prt/bake_limits.h"

enum {
    BAKE = 1 << CMD_BAKE,
    COLORS = 1 << CMD_COLORS,
    IMAGE = 1 << CMD_IMAGE,
    INFO = 1 << CMD_INFO,
    COMPARE = 1 << CMD_COMPARE,
    ENV = 1 << CMD_ENV,
    MATERIAL = 1 << CMD_MATERIAL,
    EVERY = BAKE | COLORS | IMAGE | INFO | COMPARE | ENV | MATERIAL,
    LIGHTS = COLORS | IMAGE | COMPARE,
};

static const char *const transports[] = {"wavelet", "polynomial", "joint", NULL};
static const char *const bases[] = {"reduced", "polynomial", "hat", NULL}; // prt_radial_kind
static const char *const storages[] = {"factored", "sparse", NULL};
static const char *const engines[] = {"reference", "wavelet", "polynomial", "joint", NULL};
static const char *const pictures[] = {"vertex", "splat",     "tangent", "texture",
                                       "hybrid", "reference", NULL};
static const char *const terms[] = {"irradiance", "multiple",   "single", "unscattered",
                                    "total",      "difference", NULL};
static const char *const exits[] = {"normalised", "papers", NULL};
static const char *const scatterings[] = {"dipole", "walk", NULL};
static const char *const cpus[] = {
#define X(word, bit, allowed) word,
    PRT_CPU_WORD_LIST(X)
#undef X
        NULL};
static const char *const tones[] = {"filmic", "reinhard", "none", NULL};
static const char *const conventions[] = {"guess", "camera", "gl", "d3d", "three", NULL};
static const char *const axes[] = {"y", "z", NULL};
static const char *const layouts[] = {"latlong", "envmap", "vcross", "hcross",
                                      "vstrip",  "hstrip", NULL};

#define AT(member) offsetof(struct options, member)
const struct option_row option_table[] = {
    {"output", 'o', "FILE", OPTION_TEXT, AT(out), 0, 0, NULL,
     BAKE | COLORS | IMAGE | ENV | MATERIAL, "file to write; its ending chooses the format"},
    {"material", 'm', "[OBJECT=]NAME|FILE", OPTION_MATERIAL, 0, 0, 0, NULL,
     BAKE | COLORS | IMAGE | COMPARE | INFO,
     "a preset (marble, skin1, …), a JSON file, JSON text, or a file of another program, FILE or "
     "FILE#NAME (see prt material --help); OBJECT: the glTF material or node that it is of, "
     "without it all others; may repeat"},
    {"size-mm", 0, "D", OPTION_REAL, AT(size_mm), 0, 1e6, NULL, BAKE | COLORS | IMAGE | INFO,
     "diagonal of the bounding box of the translucent objects, in mm"},
    {"mm-per-unit", 0, "X", OPTION_REAL, AT(mm_per_unit), 0, 1e9, NULL,
     BAKE | COLORS | IMAGE | INFO, "millimetres in one unit of the model"},
    {"mm-per-unit", 0, "X", OPTION_REAL, AT(mm_per_unit), 0, 1e9, NULL, MATERIAL,
     "millimetres in a unit of length where IN names none (default: MaterialX 10, Principled and "
     "glTF 1000, pbrt 1)"},
    {"opaque", 0, "NAME", OPTION_OPAQUE, 0, 0, 0, NULL, BAKE | COLORS | IMAGE | INFO,
     "a material or node that is opaque; may repeat"},
    {"texture-split", 0, "S", OPTION_SIGNED, AT(texture_split), 0, 1, NULL,
     BAKE | COLORS | IMAGE,
     "share of the model's base colour texture that scattering blurs: 0 (default) multiplies it at "
     "the pixel, 1 blurs its brightness wholly; a bake keeps it"},
    {"no-textures", 0, NULL, OPTION_FLAG, AT(no_textures), 0, 0, NULL, BAKE | COLORS | IMAGE,
     "leave the model's textures and vertex colours out"},
    {"env", 'e', "ENV", OPTION_TEXT, AT(env), 0, 0, NULL, BAKE | COLORS | IMAGE,
     "light: lat-long or cube image, folder of six faces, constant[:R,G,B]"},
    {"env", 'e', "ENV", OPTION_ENVS, 0, 0, 0, NULL, COMPARE,
     "with B = reference: the light; may repeat, each gives a column of a table"},
    {"materials", 0, "LIST", OPTION_TEXT, AT(materials), 0, 0, NULL, COMPARE,
     "with B = reference: print a table with a row for each medium of LIST: media (the measured "
     "media of the bake's eta), range (both ends of the bake's range), all (both), or "
     "NAME|FILE,…"},
    {"rotate", 0, "DEG", OPTION_SIGNED, AT(rotate_deg), -1e6, 1e6, NULL, BAKE | LIGHTS | ENV,
     "turn the light counter-clockwise about +y, seen from above"},
    {"engine", 0, "NAME", OPTION_WORD, AT(engine), 0, 0, engines, COLORS,
     "default: the transport of the .prt; reference for a model"},
    {"engine", 0, "NAME", OPTION_WORD, AT(engine), 0, 0, pictures, IMAGE,
     "default: vertex for a .prt; reference for a model"},
    {"term", 0, "NAME", OPTION_WORD, AT(term), 0, 0, terms, LIGHTS, "default: total"},
    {"eye", 0, "X,Y,Z", OPTION_VECTOR, AT(eye), 0, 0, NULL, COLORS | IMAGE | COMPARE,
     "viewpoint of view-dependent terms, in the model's units; vertices that face away are 0, and "
     "compare weighs those that it sees"},
    {"variant", 0, "NAME", OPTION_TEXT, AT(variant), 0, 0, NULL, BAKE | COLORS | IMAGE | INFO,
     "materials of this variant of a glTF (KHR_materials_variants), by its name or a unique "
     "beginning of it (prt info lists them; default: the file's own); of a .prt, a variant that "
     "leaves alone what was baked"},
    {"animation", 0, "NAME", OPTION_TEXT, AT(animation), 0, 0, NULL, COLORS | IMAGE,
     "an animation of a glTF by its name or a unique beginning of it (prt info lists them): "
     "nodes, skins and morph targets at --time; without it the model is at rest"},
    {"time", 0, "S", OPTION_SIGNED, AT(time_s), 0, 1e9, NULL, COLORS | IMAGE,
     "moment of the animation in seconds (default 0)"},
    {"camera", 0, "NAME|E:T:U:F", OPTION_TEXT, AT(camera), 0, 0, NULL, IMAGE,
     "a camera of the model's file by its name or a unique beginning of it (prt info lists "
     "them), or EYE:TARGET[:UP[:FOVY]] as x,y,z:x,y,z:x,y,z:degrees; default: frame the model"},
    {"orbit", 0, "AZ,EL[,ZOOM]", OPTION_TEXT, AT(orbit), 0, 0, NULL, IMAGE,
     "look at the framed centre from this azimuth and elevation in degrees; 0,0 looks along -z, "
     "90,0 along -x; ZOOM magnifies (default 0,15,1)"},
    {"up", 0, "AXIS", OPTION_WORD, AT(up), 0, 0, axes, BAKE | COLORS | IMAGE | INFO,
     "the model's upward axis (default y); z turns it, x,y,z becoming x,z,-y, as scans and STL "
     "files often need"},
    {"flip-v", 0, NULL, OPTION_FLAG, AT(flip_v), 0, 0, NULL, BAKE | COLORS | IMAGE | INFO,
     "the model's textures lie upside down (a face on the neck): v becomes 1 - v, as files need "
     "whose v counts upwards although glTF's counts downwards"},
    {"transport", 0, "KIND", OPTION_WORD, AT(transport), 0, 0, transports, BAKE,
     "wavelet (default with --material): the light stays free after the bake; polynomial: the "
     "material stays free; joint (default without --material): both stay free"},
    {"storage", 0, "KIND", OPTION_WORD, AT(storage), 0, 0, storages, BAKE,
     "factored (default): bases shared by clusters of vertices; sparse: one vector a vertex, as in W05"},
    {"basis", 0, "KIND", OPTION_WORD, AT(basis), 0, 0, bases, BAKE,
     "for --transport polynomial, the functions of radius: reduced (default): singular vectors "
     "of the range of media; polynomial: the 32 linear pieces of X07 (16 for single "
     "scattering); hat: hat functions on the same knots"},
    {"rank", 0, "R", OPTION_WHOLE, AT(rank), PRT_BAKE_RANK_MIN, PRT_BAKE_RANK_MAX, NULL, BAKE,
     "factored: dense numbers a vertex and term (default: chosen from --max-error)"},
    {"basis-coeffs", 0, "N", OPTION_WHOLE, AT(basis_coeffs), PRT_BAKE_BASIS_COEFFS_MIN,
     PRT_BAKE_BASIS_COEFFS_MAX, NULL, BAKE,
     "factored: mean number of coefficients a basis vector (default: chosen from --max-error)"},
    {"coeffs", 0, "N", OPTION_WHOLE, AT(coeffs), PRT_BAKE_COEFFS_MIN, PRT_BAKE_COEFFS_MAX, NULL,
     BAKE, "sparse: wavelet coefficients a vertex (default 128)"},
    {"max-error", 0, "E", OPTION_SIGNED, AT(max_error), PRT_BAKE_ERROR_MIN, PRT_BAKE_ERROR_MAX,
     NULL, BAKE,
     "largest relative RMSE that compression of factored storage may cause (default 0.01)"},
    {"cube", 0, "N", OPTION_CUBE, AT(cube), PRT_BAKE_CUBE_MIN, PRT_BAKE_CUBE_MAX, NULL, BAKE,
     "resolution 6xNxN of the light (default 32)"},
    {"cube", 0, "N|full", OPTION_CUBE, AT(cube), PRT_CUBE_MIN, PRT_CUBE_MAX, NULL, LIGHTS,
     "resolution of the light for the reference engine (default: the .prt's, else 32)"},
    {"draft", 0, NULL, OPTION_FLAG, AT(draft), 0, 0, NULL, BAKE,
     "a first bake of some 3 % error in a tenth of the time: --cube 16 --samples 20000 "
     "--max-error 0.05, unless given, single scattering from few vertices, and coarser inside; by "
     "the dipole, scaled to what walks return under even light where the bake is by walks"},
    {"profile", 0, NULL, OPTION_FLAG, AT(profile), 0, 0, NULL, BAKE,
     "print CPU seconds, rays and operations of each kind of work beside the machine's rates; "
     "takes a second more"},
    {"phase-terms", 0, "K", OPTION_WHOLE, AT(phase_terms), 1, 16, NULL, BAKE | COLORS | IMAGE,
     "spherical-harmonic terms of the phase function: 1, 4 or 9 (default of the reference engine: exact)"},
    {"samples", 0, "N", OPTION_WHOLE, AT(samples), PRT_BAKE_SAMPLES_MIN, PRT_BAKE_SAMPLES_MAX,
     NULL, BAKE,
     "irradiance samples on the surface (default: 150000, or one a mean free path; 75000 of a "
     "fixed medium whose path is long)"},
    {"samples", 0, "N", OPTION_WHOLE, AT(samples), 1, 100000000, NULL, LIGHTS,
     "irradiance samples on the surface (default: 150000, or one a mean free path)"},
    {"exit", 0, "KIND", OPTION_WORD, AT(exit), 0, 0, exits, LIGHTS,
     "how diffuse light leaves in --term total: F_t B/(pi T) with T the mean of F_t (default), "
     "which loses no light, or F_t B/pi, as the papers print it"},
    {"scattering", 0, "KIND", OPTION_WORD, AT(scattering), 0, 0, scatterings, COLORS | COMPARE,
     "reference engine: multiple scattering by the dipole (default), which takes the surface "
     "around each point for a plane, or by random walks inside the model"},
    {"scattering", 0, "KIND", OPTION_WORD, AT(scattering), 0, 0, scatterings, IMAGE,
     "reference engine: multiple scattering by the dipole (default), which takes the surface "
     "around each point for a plane, or by random walks inside the model; image-space engines: "
     "walk (default without --budget-ms) scales it to what walks return under even light, "
     "which takes seconds"},
    {"scattering", 0, "KIND", OPTION_WORD, AT(scattering), 0, 0, scatterings, BAKE,
     "multiple scattering by the dipole, which takes the surface around each point for a plane, "
     "or by random walks inside the model; default: walk for closed bodies of a fixed medium where "
     "it is estimated to take at most three times the time, else dipole; a note says which and why"},
    {"scattering", 0, "KIND", OPTION_WORD, AT(scattering), 0, 0, scatterings, INFO,
     "walk, or --material: say where and by how much the dipole differs from random walks in the "
     "media of a model or .prt under even light, which takes seconds"},
    {"walks", 0, "N", OPTION_WHOLE, AT(walks), 16, PRT_BAKE_WALKS_MAX, NULL, INFO,
     "walks of a group of points that --scattering walk or --material takes (default 256)"},
    {"walks", 0, "N", OPTION_WHOLE, AT(walks), PRT_BAKE_WALKS_MIN, PRT_BAKE_WALKS_MAX, NULL,
     BAKE,
     "with --scattering walk: walks a vertex and channel (default: by vertices, 512 to 2048); "
     "where the medium is free, a vertex and level of scattering (default 256)"},
    {"walks", 0, "N", OPTION_WHOLE, AT(walks), 1, 1 << 28, NULL, LIGHTS,
     "with --scattering walk: walks a vertex and channel (default 1024); image-space engines: a "
     "group of points, at least 16 (default 256)"},
    {"rays", 0, "N", OPTION_WHOLE, AT(rays), 1, 1 << 24, NULL, LIGHTS,
     "reference engine: rays a sample (default 2048)"},
    {"single-points", 0, "N", OPTION_WHOLE, AT(single_points), 1, PRT_BAKE_SINGLE_POINTS_MAX,
     NULL, BAKE, "with --every-ray: points of single scattering a vertex (default 16)"},
    {"single-points", 0, "N", OPTION_WHOLE, AT(single_points), 1, 1 << 20, NULL, LIGHTS,
     "single scattering: paths a vertex (default 4096)"},
    {"no-single", 0, NULL, OPTION_FLAG, AT(no_single), 0, 0, NULL, BAKE,
     "leave single scattering out"},
    {"any-eta", 0, NULL, OPTION_FLAG, AT(any_eta), 0, 0, NULL, BAKE,
     "joint: media of every refractive index from 1.2 to 1.6, not of the bake's own alone"},
    {"exit-planes", 0, NULL, OPTION_FLAG, AT(exit_planes), 0, 0, NULL, BAKE,
     "add planes that correct single scattering towards an eye (a cow: error 17 -> 5 %, almost "
     "twice the CPU time, 4 MB); a viewer's frames grow to three times their size"},
    {"every-ray", 0, NULL, OPTION_FLAG, AT(every_ray), 0, 0, NULL, BAKE,
     "trace every ray of single scattering, without reuse; for measurements"},
    {"straight", 0, NULL, OPTION_FLAG, AT(straight), 0, 0, NULL, COLORS | IMAGE,
     "reference engine: single scattering along -n_o even with --eye, as in W05"},
    {"seed", 0, "N", OPTION_WHOLE, AT(seed), 0, 1.8e19, NULL, BAKE | LIGHTS,
     "seed of all random numbers (default 0)"},
    {"shard", 0, "I/N", OPTION_SHARD, AT(shard), 0, 0, NULL, BAKE,
     "bake part I of N, I from 0 to N-1, and write it beside OUT.prt; the last part to finish "
     "assembles OUT.prt, the same bytes as an undivided bake"},
    {"checkpoint", 0, "FILE", OPTION_TEXT, AT(checkpoint), 0, 0, NULL, BAKE,
     "keep finished work in FILE and FILE.rows; the same command goes on from there after an "
     "interruption, and removes them when OUT.prt is written"},
    {"checkpoint-room", 0, "BYTES", OPTION_WHOLE, AT(checkpoint_room), 1, 1e18, NULL, BAKE,
     "most bytes that the checkpoint takes (default: no bound)"},
    {"cache", 0, "DIR", OPTION_TEXT, AT(cache), 0, 0, NULL, BAKE,
     "keep results of rays in DIR: another bake of the same model, with any material or scale, or "
     "of one that was changed in parts, casts only those that are not there or that the change "
     "can reach; it writes the same bytes as without DIR"},
    {"cache-room", 0, "BYTES", OPTION_WHOLE, AT(cache_room), 1, 1e18, NULL, BAKE,
     "most bytes of DIR; files that were not used for longest are removed beyond it (default 8 GiB)"},
    {"size", 0, "WxH", OPTION_SIZE, AT(width), 1, 4096, NULL, IMAGE,
     "size in pixels (default 800x600)"},
    {"size", 0, "N|WxH", OPTION_SIDE, AT(width), 1, 16384, NULL, ENV,
     "side of a cube face, or width and height of a lat-long image"},
    {"faces", 0, "KIND", OPTION_WORD, AT(faces), 0, 0, conventions, BAKE | LIGHTS | INFO | ENV,
     "how six faces, strips, crosses, DDS and KTX cubes lie (default guess, by the edges that fit): "
     "camera views with -z in front; gl: OpenGL's axes, mirrored pictures; d3d: a left-handed "
     "world; three: files of three.js"},
    {"layout", 0, "NAME", OPTION_WORD, AT(layout), 0, 0, layouts, ENV,
     "layout of the result; default: envmap (cube faces in one EXR) for a lat-long input, else latlong"},
    {"msaa", 0, "N", OPTION_WHOLE, AT(msaa), 1, 8, NULL, IMAGE,
     "samples a pixel: 1, 2, 4 or 8 (default 4)"},
    {"exposure", 0, "EV", OPTION_SIGNED, AT(exposure_ev), -40, 40, NULL, IMAGE | ENV,
     "brighten pictures of 8 bits by a factor 2^EV"},
    {"tone", 0, "NAME", OPTION_WORD, AT(tone), 0, 0, tones, IMAGE | ENV,
     "tone map of pictures of 8 bits (default filmic)"},
    {"background", 0, "B", OPTION_TEXT, AT(background), 0, 0, NULL, IMAGE,
     "env (default), none (black), transparent (alpha: EXR with premultiplied colours, PNG with straight "
     "ones), or R,G,B as linear radiance"},
    {"floor", 0, NULL, OPTION_FLAG, AT(floor), 0, 0, NULL, IMAGE,
     "draw the model's shadow on a horizontal plane under it, over the background"},
    {"budget-ms", 0, "MS", OPTION_REAL, AT(budget_ms), 0, 1e7, NULL, IMAGE,
     "image-space engines: time for one picture, in ms"},
    {"albedo-map", 0, "FILE", OPTION_TEXT, AT(albedo_map), 0, 0, NULL, IMAGE,
     "image-space engines: an image over the model's uv (row 0 at v = 0, as in glTF); its colours "
     "multiply the medium's reflectance, by absorption"},
    {"normal-map", 0, "FILE", OPTION_TEXT, AT(normal_map), 0, 0, NULL, IMAGE,
     "image-space engines: tangent-space normals; they change the incident light"},
    {"bump-map", 0, "FILE", OPTION_TEXT, AT(bump_map), 0, 0, NULL, IMAGE,
     "image-space engines: heights (red channel); they change the incident light"},
    {"bump-mm", 0, "H", OPTION_REAL, AT(bump_mm), 0, 1e4, NULL, IMAGE,
     "height in mm of white in --bump-map (default 0.5)"},
    {"measure-error", 0, NULL, OPTION_FLAG, AT(measure_error), 0, 0, NULL, IMAGE,
     "print the error of reflections against traced rays, and for image-space engines the error at "
     "some pixels against brute force; --json has both"},
    {"quality", 0, "Q", OPTION_WHOLE, AT(quality), 1, 100, NULL, IMAGE | ENV,
     "quality of a JPEG (default 92)"},
    {"float", 0, NULL, OPTION_FLAG, AT(full_float), 0, 0, NULL, IMAGE | ENV,
     "write EXR with 32-bit floats instead of halves"},
    {"max-rmse", 0, "X", OPTION_SIGNED, AT(max_rmse), 0, 1e30, NULL, COMPARE,
     "exit with status 1 when the relative RMSE is above X"},
    {"vertices", 0, "N", OPTION_WHOLE, AT(vertices), 1, 100000000, NULL, COMPARE,
     "with B = reference: number of random vertices to compare (default 512)"},
    {"threads", 0, "N", OPTION_WHOLE, AT(threads), 1, 1024, NULL, EVERY,
     "number of threads (default: all cores)"},
    {"cpu", 0, "ISA", OPTION_WORD, AT(cpu), 0, 0, cpus, EVERY,
     "use no more than this instruction set"},
    {"progress-fd", 0, "FD", OPTION_FD, AT(progress_fd), 0, 0, NULL, BAKE | COLORS | IMAGE,
     "write progress to this file descriptor, as lines \"stage fraction eta-seconds\""},
    {"memory", 0, "BYTES", OPTION_WHOLE, AT(memory), 0, 1e15, NULL, BAKE,
     "make do with this much, rows in unlinked files of TMPDIR (/var/tmp) where needed, and fail "
     "when that does not suffice; 0: the estimate for the settings. Without it a bake makes do with "
     "half of what is free"},
    {"estimate", 0, NULL, OPTION_FLAG, AT(estimate), 0, 0, NULL, BAKE,
     "print what the bake is estimated to need, and do not bake: bytes of memory, CPU seconds, and "
     "of them those that each shard takes"},
    {"accept-weak-sandbox", 0, NULL, OPTION_FLAG, AT(accept_weak_sandbox), 0, 0, NULL, EVERY,
     "decode files although the system cannot confine the decoding process"},
    {"json", 0, NULL, OPTION_FLAG, AT(json), 0, 0, NULL, EVERY,
     "print the answer as one JSON object"},
    {"quiet", 'q', NULL, OPTION_FLAG, AT(quiet), 0, 0, NULL, EVERY,
     "print no notes and no progress bar"},
};
const unsigned n_option_row = sizeof option_table / sizeof *option_table;
