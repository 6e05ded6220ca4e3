// SPDX-License-Identifier: MIT
// A random request of a random type. Types with a function here name what is there; one of
// eight requests has fields that mean nothing.
#include "any_fields.h"
#include "messages.h"

#include <stdlib.h>

#include "relight.pb-c.h"

static char *token_name(struct rnd *r)
{
    static char *const names[] = {"a", "b", "c", "default", "", "a b", "../a"};
    return RND_PICK(r, names);
}

static void any_ping(struct world *world, uint64_t id, uint64_t other, struct bytes *out)
{
    struct rnd *r = world->rnd;
    Relight__PingRequest in = RELIGHT__PING_REQUEST__INIT;
    message_emit(world, RELIGHT_TYPE_PING, id, &in.base, world->blob, rnd(r, 3000), out);
}

static void any_list(struct world *world, uint64_t id, uint64_t other, struct bytes *out)
{
    struct rnd *r = world->rnd;
    Relight__ListRequest in = RELIGHT__LIST_REQUEST__INIT;
    in.files = rnd_chance(r, 2);
    in.environments = rnd_chance(r, 2);
    EMIT(LIST, in);
}

static void any_put_blob(struct world *world, uint64_t id, uint64_t other, struct bytes *out)
{
    struct rnd *r = world->rnd;
    message_upload(world, id, rnd(r, WORLD_BLOBS), out);
}

static void any_env(struct world *world, uint64_t id, uint64_t other, struct bytes *out)
{
    Relight__EnvRequest in = RELIGHT__ENV_REQUEST__INIT;
    char text[128];
    in.env = message_environment(world, text);
    EMIT(ENV, in);
}

static void any_load(struct world *world, uint64_t id, uint64_t other, struct bytes *out)
{
    struct rnd *r = world->rnd;
    message_load(world, id, rnd_chance(r, 2) ? LOAD_PREVIEW : LOAD_BAKE, out);
}

static void any_watch(struct world *world, uint64_t id, uint64_t other, struct bytes *out)
{
    struct rnd *r = world->rnd;
    Relight__WatchRequest in = RELIGHT__WATCH_REQUEST__INIT;
    in.job = (char *)(rnd_chance(r, 3) ? world_any_model(world) : world_job(world));
    EMIT(WATCH, in);
}

static void any_cancel_job(struct world *world, uint64_t id, uint64_t other, struct bytes *out)
{
    struct rnd *r = world->rnd;
    message_cancel_job(world, id, rnd_chance(r, 6) ? world_any_model(world) : world_job(world),
                       out);
}

static void any_cancel(struct world *world, uint64_t id, uint64_t other, struct bytes *out)
{
    Relight__CancelRequest in = RELIGHT__CANCEL_REQUEST__INIT;
    in.id = other;
    EMIT(CANCEL, in);
}

static void any_info(struct world *world, uint64_t id, uint64_t other, struct bytes *out)
{
    Relight__InfoRequest in = RELIGHT__INFO_REQUEST__INIT;
    in.model = (char *)world_any_model(world);
    EMIT(INFO, in);
}

static void any_geometry(struct world *world, uint64_t id, uint64_t other, struct bytes *out)
{
    struct rnd *r = world->rnd;
    Relight__GeometryRequest in = RELIGHT__GEOMETRY_REQUEST__INIT;
    in.model = (char *)world_any_model(world);
    in.no_normals = rnd_chance(r, 3);
    in.no_triangles = rnd_chance(r, 3);
    in.own_units = rnd_chance(r, 2);
    in.pose = world_any_pose(world);
    in.coarse = rnd_chance(r, 4);
    EMIT(GEOMETRY, in);
}

static void any_view_close(struct world *world, uint64_t id, uint64_t other, struct bytes *out)
{
    Relight__ViewCloseRequest in = RELIGHT__VIEW_CLOSE_REQUEST__INIT;
    in.view = other;
    EMIT(VIEW_CLOSE, in);
}

static void any_get_blob(struct world *world, uint64_t id, uint64_t other, struct bytes *out)
{
    struct rnd *r = world->rnd;
    Relight__GetBlobRequest in = RELIGHT__GET_BLOB_REQUEST__INIT;
    in.hash = rnd_chance(r, 12) ? "../x" : world->blob[rnd(r, WORLD_BLOBS)].hash;
    in.offset = rnd_chance(r, 2) ? 0 : rnd_chance(r, 2) ? rnd(r, 4000) : rnd_bits(r);
    in.size = rnd_chance(r, 2) ? 0 : rnd(r, 3000);
    EMIT(GET_BLOB, in);
}

static void any_factors(struct world *world, uint64_t id, uint64_t other, struct bytes *out)
{
    struct rnd *r = world->rnd;
    Relight__FactorsRequest in = RELIGHT__FACTORS_REQUEST__INIT;
    in.model = (char *)world_any_model(world);
    in.first = rnd_chance(r, 2) ? 0 : rnd_chance(r, 2) ? 2 * rnd(r, 9) : (uint32_t)rnd_odd(r);
    in.most_rank = rnd_chance(r, 2)   ? 0
                   : rnd_chance(r, 2) ? 2 * rnd(r, 9)
                                      : (uint32_t)rnd_odd(r);
    in.exits = rnd_chance(r, 2);
    EMIT(FACTORS, in);
}

static void any_unload(struct world *world, uint64_t id, uint64_t other, struct bytes *out)
{
    struct rnd *r = world->rnd;
    Relight__UnloadRequest in = RELIGHT__UNLOAD_REQUEST__INIT;
    in.model = (char *)world_any_model(world);
    in.forget = rnd_chance(r, 2);
    EMIT(UNLOAD, in);
}

static void any_view_ack(struct world *world, uint64_t id, uint64_t other, struct bytes *out)
{
    struct rnd *r = world->rnd;
    Relight__ViewAck in = RELIGHT__VIEW_ACK__INIT;
    in.view = other;
    in.shown = rnd_chance(r, 2) ? rnd(r, 8) : rnd_bits(r) >> rnd(r, 64);
    message_emit(world, RELIGHT_TYPE_VIEW_ACK, rnd_chance(r, 30) ? id : 0, &in.base, NULL, 0,
                 out);
}

static void any_subscribe(struct world *world, uint64_t id, uint64_t other, struct bytes *out)
{
    struct rnd *r = world->rnd;
    if (rnd_chance(r, 2)) {
        message_room(world, RELIGHT_TYPE_SUBSCRIBE, id, other, out);
        return;
    }
    Relight__SubscribeRequest in = RELIGHT__SUBSCRIBE_REQUEST__INIT;
    Relight__EventKind kinds[40];
    in.kinds = kinds;
    in.n_kinds = rnd_chance(r, 3) ? rnd(r, 40) : 0;
    for (size_t i = 0; i < in.n_kinds; i++) kinds[i] = (Relight__EventKind)rnd(r, 9);
    if (rnd_chance(r, 4)) in.model = (char *)world_any_model(world);
    if (rnd_chance(r, 2)) in.run = "0123456789abcdef"; // rooms_start()
    in.after = rnd_chance(r, 2) ? rnd(r, 2000) : rnd_odd(r);
    EMIT(SUBSCRIBE, in);
}

static void any_token_create(struct world *world, uint64_t id, uint64_t other,
                             struct bytes *out)
{
    struct rnd *r = world->rnd;
    Relight__TokenCreateRequest in = RELIGHT__TOKEN_CREATE_REQUEST__INIT;
    Relight__TokenQuotas quotas = RELIGHT__TOKEN_QUOTAS__INIT;
    static char *scopes[] = {"view", "edit", "upload", "admin", "view,edit", "see"};
    in.name = token_name(r);
    in.scopes = scopes + rnd(r, 3);
    in.n_scopes = rnd(r, 4);
    in.lifetime_s = rnd_chance(r, 3) ? rnd_odd(r) : 0;
    quotas.rate = rnd_chance(r, 3) ? 1e-3 * rnd(r, 100000) : 0;
    quotas.models = rnd_chance(r, 3) ? rnd_odd(r) : 0;
    quotas.memory = rnd_chance(r, 3) ? rnd_odd(r) : 0;
    if (rnd_chance(r, 2)) in.quotas = &quotas;
    EMIT(TOKEN_CREATE, in);
}

static void any_token_list(struct world *world, uint64_t id, uint64_t other, struct bytes *out)
{
    Relight__TokenListRequest in = RELIGHT__TOKEN_LIST_REQUEST__INIT;
    EMIT(TOKEN_LIST, in);
}

static void any_token_revoke(struct world *world, uint64_t id, uint64_t other,
                             struct bytes *out)
{
    struct rnd *r = world->rnd;
    Relight__TokenRevokeRequest in = RELIGHT__TOKEN_REVOKE_REQUEST__INIT;
    in.name = token_name(r);
    EMIT(TOKEN_REVOKE, in);
}

static void any_stats(struct world *world, uint64_t id, uint64_t other, struct bytes *out)
{
    Relight__StatsRequest in = RELIGHT__STATS_REQUEST__INIT;
    EMIT(STATS, in);
}

// `other`: the id of another request, or a number of a room.
typedef void (*any_fn)(struct world *world, uint64_t id, uint64_t other, struct bytes *out);

// A request of any type of frame.h, also of those without a function here.
static uint16_t of_any_type(struct world *world, uint64_t id, struct bytes *out)
{
    struct rnd *r = world->rnd;
    const size_t at = rnd(r, N_REQUEST_TYPE);
    const uint16_t type = request_types[at].type;
    const bool answered = request_types[at].answered;
    const size_t n = answered && rnd_chance(r, 2) ? rnd(r, sizeof world->blob->bytes) : 0;
    ProtobufCMessage *message = any_fields(r, relight_type_message(type));
    if (!message) abort();
    message_emit(world, type, answered ? id : 0, message, n ? world->blob->bytes : NULL, n,
                 out);
    protobuf_c_message_free_unpacked(message, NULL);
    return type;
}

uint16_t message_random(struct world *world, uint64_t id, uint32_t ids, struct bytes *out)
{
    // Twice or more where much state hangs on it; without a function: a room's.
    static const struct {
        uint16_t type;
        any_fn add;
    } any[] = {
        {RELIGHT_TYPE_PING, any_ping},
        {RELIGHT_TYPE_LIST, any_list},
        {RELIGHT_TYPE_PUT_BLOB, any_put_blob},
        {RELIGHT_TYPE_PUT_BLOB, any_put_blob},
        {RELIGHT_TYPE_ENV, any_env},
        {RELIGHT_TYPE_LOAD, any_load},
        {RELIGHT_TYPE_LOAD, any_load},
        {RELIGHT_TYPE_WATCH, any_watch},
        {RELIGHT_TYPE_WATCH, any_watch},
        {RELIGHT_TYPE_CANCEL_JOB, any_cancel_job},
        {RELIGHT_TYPE_CANCEL_JOB, any_cancel_job},
        {RELIGHT_TYPE_CANCEL, any_cancel},
        {RELIGHT_TYPE_CANCEL, any_cancel},
        {RELIGHT_TYPE_INFO, any_info},
        {RELIGHT_TYPE_GEOMETRY, any_geometry},
        {RELIGHT_TYPE_COLORS, message_colors},
        {RELIGHT_TYPE_COLORS, message_colors},
        {RELIGHT_TYPE_IMAGE, message_image},
        {RELIGHT_TYPE_VIEW_OPEN, message_view_open},
        {RELIGHT_TYPE_VIEW_OPEN, message_view_open},
        {RELIGHT_TYPE_VIEW_OPEN, message_view_open},
        {RELIGHT_TYPE_VIEW_SET, message_view_set},
        {RELIGHT_TYPE_VIEW_SET, message_view_set},
        {RELIGHT_TYPE_VIEW_SET, message_view_set},
        {RELIGHT_TYPE_VIEW_CLOSE, any_view_close},
        {RELIGHT_TYPE_UPDATE_VERTICES, message_update_vertices},
        {RELIGHT_TYPE_UNLOAD, any_unload},
        {RELIGHT_TYPE_STATS, any_stats},
        {RELIGHT_TYPE_SUBSCRIBE, any_subscribe},
        {RELIGHT_TYPE_SUBSCRIBE, any_subscribe},
        {RELIGHT_TYPE_TOKEN_CREATE, any_token_create},
        {RELIGHT_TYPE_TOKEN_LIST, any_token_list},
        {RELIGHT_TYPE_TOKEN_REVOKE, any_token_revoke},
        {RELIGHT_TYPE_VIEW_ACK, any_view_ack},
        {RELIGHT_TYPE_VIEW_ACK, any_view_ack},
        {RELIGHT_TYPE_PUT_POSE, message_put_pose},
        {RELIGHT_TYPE_PUT_POSE, message_put_pose},
        {RELIGHT_TYPE_GET_BLOB, any_get_blob},
        {RELIGHT_TYPE_FACTORS, any_factors},
        {RELIGHT_TYPE_ROOM_CREATE, NULL},
        {RELIGHT_TYPE_ROOM_EDIT, NULL},
        {RELIGHT_TYPE_ROOM_EDIT, NULL},
        {RELIGHT_TYPE_ROOM_EDIT, NULL},
        {RELIGHT_TYPE_ROOM_GET, NULL},
        {RELIGHT_TYPE_ROOM_LIST, NULL},
        {RELIGHT_TYPE_ROOM_PICTURE, NULL},
        {RELIGHT_TYPE_ROOM_PRESENCE, NULL},
        {RELIGHT_TYPE_ROOM_BACKUP, NULL},
        {RELIGHT_TYPE_MATERIAL, NULL},
    };
    struct rnd *r = world->rnd;
    if (rnd_chance(r, 8)) return of_any_type(world, id, out);
    const size_t n = rnd(r, sizeof any / sizeof *any);
    uint64_t other = 1 + rnd(r, ids);
    if (any[n].add) any[n].add(world, id, other, out);
    else message_room(world, any[n].type, id, other, out);
    return any[n].type;
}
