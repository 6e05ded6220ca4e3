// SPDX-License-Identifier: MIT
// What a fuzzer has learned of the daemon: blobs, models, jobs, poses and rooms to name.
#include "messages.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "prt/mesh.h"
#include "synthetic.h"

// The mesh that the made-up bakes are of, as a GLB.
static void make_glb(struct blob *blob)
{
    struct prt_mesh mesh;
    char json[1200];
    if (synthetic_mesh(MODEL_VERTICES, false, &mesh)) abort();
    unsigned positions = 12 * mesh.n_vertex, triangles = 12 * mesh.n_triangle;
    int n = snprintf(
        json, sizeof json,
        "{\"asset\":{\"version\":\"2.0\"},\"scene\":0,\"scenes\":[{\"nodes\":[0]}],"
        "\"nodes\":[{\"mesh\":0}],\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0},"
        "\"indices\":1}]}],\"buffers\":[{\"byteLength\":%u}],\"bufferViews\":["
        "{\"buffer\":0,\"byteLength\":%u},{\"buffer\":0,\"byteOffset\":%u,\"byteLength\":%u}],"
        "\"accessors\":[{\"bufferView\":0,\"componentType\":5126,\"count\":%u,\"type\":\"VEC3\","
        "\"min\":[0,-1,0],\"max\":[4,1,5]},{\"bufferView\":1,\"componentType\":5125,"
        "\"count\":%u,\"type\":\"SCALAR\"}]}",
        positions + triangles, positions, positions, triangles, mesh.n_vertex,
        3 * mesh.n_triangle);
    while (n % 4) json[n++] = ' ';
    uint32_t text = (uint32_t)n, binary = positions + triangles;
    uint32_t head[5] = {0x46546c67, 2, 28 + text + binary, text, 0x4e4f534a};
    uint32_t chunk[2] = {binary, 0x004e4942};
    struct bytes all = {0};
    bytes_add(&all, head, sizeof head);
    bytes_add(&all, json, text);
    bytes_add(&all, chunk, sizeof chunk);
    bytes_add(&all, mesh.position, positions);
    bytes_add(&all, mesh.triangle, triangles);
    if (all.n > sizeof blob->bytes) abort();
    memcpy(blob->bytes, all.at, all.n);
    blob->n = all.n;
    strcpy(blob->name, "tiny.glb");
    free(all.at);
    synthetic_mesh_finish(&mesh);
}

static void make_hdr(struct blob *blob)
{
    static const char head[] = "#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 4 +X 8\n";
    memcpy(blob->bytes, head, sizeof head - 1);
    blob->n = sizeof head - 1;
    for (int i = 0; i < 32; i++, blob->n += 4)
        memcpy(blob->bytes + blob->n, (uint8_t[]){(uint8_t)(8 * i), 100, 50, 129}, 4);
    strcpy(blob->name, "sky.hdr");
}

void world_init(struct world *world, struct rnd *r)
{
    *world = (struct world){.rnd = r};
    make_glb(&world->blob[0]);
    make_hdr(&world->blob[1]);
    for (unsigned b = 2; b < WORLD_BLOBS; b++) {
        struct blob *blob = &world->blob[b];
        blob->n = b == 2 ? 64 : 3000;
        for (size_t i = 0; i < blob->n; i++) blob->bytes[i] = (uint8_t)rnd(r, 256);
        if (b == 2) memcpy(blob->bytes, "\x89PNG\r\n\x1a\n", 8);
        strcpy(blob->name, b == 2 ? "map.png" : "noise");
    }
    for (unsigned b = 0; b < WORLD_BLOBS; b++) {
        struct relight_sha256 sha;
        relight_sha256_init(&sha);
        relight_sha256_add(&sha, world->blob[b].bytes, world->blob[b].n);
        relight_sha256_hex(&sha, world->blob[b].hash);
    }
}

void world_forget(struct world *world)
{
    world->n_model = world->n_job = world->n_pose = world->n_room = 0;
}

void world_learn_model(struct world *world, const char *id)
{
    for (unsigned i = 0; i < world->n_model && i < WORLD_MODELS; i++)
        if (!strcmp(world->model[i], id)) return;
    unsigned at =
        world->n_model < WORLD_MODELS ? world->n_model++ : rnd(world->rnd, WORLD_MODELS);
    snprintf(world->model[at], sizeof world->model[at], "%s", id);
}

void world_learn_pose(struct world *world, const char *name)
{
    unsigned at = world->n_pose < WORLD_POSES ? world->n_pose++ : rnd(world->rnd, WORLD_POSES);
    snprintf(world->pose[at], sizeof world->pose[at], "%s", name);
}

void world_learn_room(struct world *world, const char *id)
{
    unsigned at = world->n_room < WORLD_ROOMS ? world->n_room++ : rnd(world->rnd, WORLD_ROOMS);
    snprintf(world->room[at], sizeof world->room[at], "%s", id);
}

// Rarely one: pictures of poses are drawn by slower engines.
char *world_any_pose(struct world *world)
{
    struct rnd *r = world->rnd;
    if (!rnd_chance(r, 4)) return "";
    if (!world->n_pose || rnd_chance(r, 12))
        return rnd_chance(r, 2) ? "abc" : world->blob[0].hash;
    return world->pose[rnd(r, world->n_pose)];
}

void world_learn_job(struct world *world, const char *id)
{
    for (unsigned i = 0; i < world->n_job; i++)
        if (!strcmp(world->job[i], id)) return;
    unsigned at = world->n_job < WORLD_JOBS ? world->n_job++ : rnd(world->rnd, WORLD_JOBS);
    snprintf(world->job[at], sizeof world->job[at], "%s", id);
    world->cancelled[at] = false;
}

const char *world_job(struct world *world)
{
    struct rnd *r = world->rnd;
    unsigned at = rnd(r, world->n_job);
    if (!world->n_job || rnd_chance(r, 16)) return rnd_chance(r, 2) ? "job-1" : "job-none";
    for (unsigned i = 0; i < world->n_job && world->cancelled[at] && !rnd_chance(r, 2000); i++)
        at = (at + 1) % world->n_job;
    return world->job[at];
}

const char *world_any_model(struct world *world)
{
    static const char *const other[] = {"", "tiny", "tiny.glb", "no such model",
                                        "0123456789abcdef"};
    struct rnd *r = world->rnd;
    if (!world->n_model || rnd_chance(r, 12)) return RND_PICK(r, other);
    return world->model[rnd(r, world->n_model)];
}
