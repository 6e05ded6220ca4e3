// SPDX-License-Identifier: MIT
// Review rooms on a daemon: how long a room of 100,000 events takes to open, what rooms at rest
// cost, and how long an edit takes from one client to another.
#include "serve_client.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "relight/relight.h"

enum { EVENTS = 100000, QUICK_EVENTS = 3000, ROOMS = 1000, QUICK_ROOMS = 50, PIPELINED = 200 };
enum { PINS = 4000, OPENS = 7, MOST_EDITS = 400, SEAT = 1 };

struct rooms_run {
    struct bench_env *env;
    struct bench_daemon daemon;
    struct serve_crowd crowd; // client 0 acts, client 1 sits in the room
    char room[64], model[64];
    unsigned sent, n_error;
    uint64_t pin; // newest
    double answered_s, told_s;
    uint64_t answer_bytes;
    char error[160];
};

static void answered(struct serve_client *c, const struct relight_frame *frame)
{
    struct rooms_run *run = c->crowd->user;
    ProtobufCMessage *m = relight_frame_unpack(frame);
    if (frame->type == RELIGHT_TYPE_ERROR) {
        run->n_error++;
        if (m) snprintf(run->error, sizeof run->error, "%s", ((Relight__Error *)m)->text);
    } else if (m && frame->type == (RELIGHT_TYPE_ROOM_CREATE | RELIGHT_TYPE_ANSWER)) {
        snprintf(run->room, sizeof run->room, "%s", ((Relight__RoomCreateAnswer *)m)->room);
    } else if (m && frame->type == (RELIGHT_TYPE_SUBSCRIBE | RELIGHT_TYPE_ANSWER)) {
        if (((Relight__Event *)m)->kind == RELIGHT__EVENT_KIND__EVENT_ROOM_EVENTS)
            run->told_s = prt_time_s();
    } else {
        run->answered_s = prt_time_s();
        run->answer_bytes = frame->payload_size;
    }
    if (m) protobuf_c_message_free_unpacked(m, NULL);
}

static int settle(struct rooms_run *run)
{
    while (run->crowd.client[0].open && !run->crowd.n_gone) serve_turn(&run->crowd, 100);
    if (!run->n_error && !run->crowd.n_gone) return PRT_OK;
    return prt_fail(&run->env->ctx, PRT_IO, "rooms: %s", run->error);
}

static int create(struct rooms_run *run, const char *name)
{
    Relight__RoomCreateRequest m = RELIGHT__ROOM_CREATE_REQUEST__INIT;
    Relight__Scene scene = RELIGHT__SCENE__INIT;
    m.name = (char *)name;
    m.me = "bench";
    m.scene = &scene;
    scene.model = run->model;
    serve_send(&run->crowd.client[0], RELIGHT_TYPE_ROOM_CREATE, &m.base, NULL, 0, 0);
    return settle(run);
}

// The i-th of a review's events: mostly the light is turned, some pins, many replies.
static void send_edit(struct rooms_run *run, unsigned i)
{
    Relight__RoomEditRequest m = RELIGHT__ROOM_EDIT_REQUEST__INIT;
    Relight__RoomAction action = RELIGHT__ROOM_ACTION__INIT;
    Relight__SceneChange change = RELIGHT__SCENE_CHANGE__INIT;
    Relight__Scene scene = RELIGHT__SCENE__INIT;
    Relight__Light light = RELIGHT__LIGHT__INIT, *lights[] = {&light};
    Relight__PutPin pin = RELIGHT__PUT_PIN__INIT;
    Relight__SurfacePoint at = RELIGHT__SURFACE_POINT__INIT;
    Relight__PutNote note = RELIGHT__PUT_NOTE__INIT;
    char *parts[] = {"lights"}, me[16];
    snprintf(me, sizeof me, "person %u", i % 20);
    m.room = run->room;
    m.name = me;
    m.action = &action;
    light.env = "constant:1,1,1";
    light.rotate_deg = (float)(i % 360);
    scene.lights = lights;
    scene.n_lights = 1;
    change.scene = &scene;
    change.parts = parts;
    change.n_parts = 1;
    pin.text = "the ear is too red, and the light comes from below";
    pin.at = &at;
    at.triangle = i % 1000;
    note.target = run->pin;
    note.text = "I see it; half the absorption of red would do";
    if (i % 25 == 0 && i / 25 < PINS) {
        action.pin = &pin;
        if (!run->pin) run->pin = 2; // the room's first event after its beginning
    } else if (i % 4 == 1 && i < 4 * 950) {
        action.reply = &note;
    } else {
        action.scene = &change;
    }
    serve_send(&run->crowd.client[0], RELIGHT_TYPE_ROOM_EDIT, &m.base, NULL, 0, 0);
}

static int fill(struct rooms_run *run, unsigned n)
{
    for (unsigned i = 0; i < n && !run->n_error && !run->crowd.n_gone; i++) {
        send_edit(run, i);
        if (!i) {
            int status = settle(run);
            if (status) return status;
        }
        while (run->crowd.client[0].open >= PIPELINED && !run->crowd.n_gone)
            serve_turn(&run->crowd, 100);
    }
    return settle(run);
}

// ---- opening

static int compare(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

static int open_room(struct rooms_run *run, double *seconds)
{
    Relight__RoomGetRequest m = RELIGHT__ROOM_GET_REQUEST__INIT;
    m.room = run->room;
    usleep(600000); // longer than --room-idle: it has left memory
    double begin = prt_time_s();
    serve_send(&run->crowd.client[0], RELIGHT_TYPE_ROOM_GET, &m.base, NULL, 0, 0);
    int status = settle(run);
    *seconds = run->answered_s - begin;
    return status;
}

static int measure_open(struct rooms_run *run)
{
    unsigned n = run->env->quick ? QUICK_EVENTS : EVENTS;
    double opens[OPENS], begin = prt_time_s();
    int status = create(run, "large");
    if (!status) status = fill(run, n);
    double filled_s = prt_time_s() - begin;
    for (int i = 0; i < OPENS && !status; i++) status = open_room(run, &opens[i]);
    if (status) return status;
    qsort(opens, OPENS, sizeof *opens, compare);
    bench_begin(run->env, "rooms_open");
    bench_number("events", n);
    bench_number("state_bytes", (double)run->answer_bytes);
    bench_number("median_ms", opens[OPENS / 2] * 1e3);
    bench_number("worst_ms", opens[OPENS - 1] * 1e3);
    bench_number("target_ms", 200);
    bench_number("acknowledged_per_s", n / filled_s);
    bench_end();
    return PRT_OK;
}

// ---- at rest

static double store_bytes(const struct rooms_run *run)
{
    static const char *const names[] = {"rooms.sqlite", "rooms.sqlite-wal"};
    double all = 0;
    for (int i = 0; i < 2; i++) {
        char path[128];
        snprintf(path, sizeof path, "%s/data/%s", run->daemon.folder, names[i]);
        FILE *file = fopen(path, "rb");
        if (file && !fseek(file, 0, SEEK_END)) all += (double)ftell(file);
        if (file) fclose(file);
    }
    return all;
}

static int some_rooms(struct rooms_run *run, unsigned n)
{
    int status = PRT_OK;
    for (unsigned i = 0; i < n && !status; i++) {
        char name[32];
        snprintf(name, sizeof name, "room %u", i);
        status = create(run, name);
        for (unsigned k = 0; k < 20 && !status; k++) send_edit(run, 4 * k + 2);
        if (!status) status = settle(run);
    }
    usleep(1500000);
    return status;
}

static int measure_rest(struct rooms_run *run)
{
    unsigned n = run->env->quick ? QUICK_ROOMS : ROOMS;
    int status = some_rooms(run, n / 10 + 1); // what the first rooms allocate once
    double rss = bench_daemon_rss_kib(&run->daemon), disk = store_bytes(run);
    if (!status) status = some_rooms(run, n);
    if (status) return status;
    bench_begin(run->env, "rooms_at_rest");
    bench_number("rooms", n);
    bench_number("events", 21);
    bench_number("memory_kib_a_room", (bench_daemon_rss_kib(&run->daemon) - rss) / n);
    bench_number("target_memory_kib_a_room", 16);
    bench_number("disk_kib_a_room", (store_bytes(run) - disk) / 1024 / n);
    bench_end();
    return PRT_OK;
}

// ---- from one to another

static int measure_edits(struct rooms_run *run)
{
    Relight__SubscribeRequest m = RELIGHT__SUBSCRIBE_REQUEST__INIT;
    double told[MOST_EDITS], acknowledged[MOST_EDITS];
    unsigned n = 0, most = run->env->quick ? 10 : MOST_EDITS;
    double end_s = prt_time_s() + 20 * run->env->seconds;
    m.room = run->room;
    serve_send(&run->crowd.client[SEAT], RELIGHT_TYPE_SUBSCRIBE, &m.base, NULL, 0, 0);
    for (int i = 0; i < 20; i++) serve_turn(&run->crowd, 20);
    for (; n < most && (n < 10 || prt_time_s() < end_s) && !run->n_error; n++) {
        double begin = prt_time_s();
        run->told_s = run->answered_s = 0;
        send_edit(run, 4 * n + 2);
        while (!(run->told_s > 0 && run->answered_s > 0) && !run->n_error && !run->crowd.n_gone)
            serve_turn(&run->crowd, 100);
        told[n] = run->told_s - begin;
        acknowledged[n] = run->answered_s - begin;
    }
    if (run->n_error || run->crowd.n_gone)
        return prt_fail(&run->env->ctx, PRT_IO, "rooms: %s", run->error);
    qsort(told, n, sizeof *told, compare);
    qsort(acknowledged, n, sizeof *acknowledged, compare);
    bench_begin(run->env, "rooms_edit");
    bench_number("edits", n);
    bench_number("acknowledged_median_ms", acknowledged[n / 2] * 1e3);
    bench_number("seen_by_another_median_ms", told[n / 2] * 1e3);
    bench_number("seen_by_another_p95_ms", told[n * 95 / 100] * 1e3);
    bench_number("target_p95_ms", 150);
    bench_end();
    return PRT_OK;
}

// A pin needs the model's id.
static int find_model(struct rooms_run *run)
{
    struct relight_client *client;
    struct relight_model model;
    struct relight_error error;
    if (relight_connect(run->daemon.address[0], NULL, &client, &error))
        return prt_fail(&run->env->ctx, PRT_IO, "%s", error.text);
    int status = relight_info(client, run->daemon.model, &model, &error);
    if (!status) {
        snprintf(run->model, sizeof run->model, "%s", model.id);
        relight_model_finish(&model);
    }
    relight_close(client);
    return status ? prt_fail(&run->env->ctx, PRT_IO, "%s", error.text) : PRT_OK;
}

static int rooms(struct bench_env *env)
{
    static const char *const options[] = {"--room-idle", "0.3", "--client-rooms", "100000",
                                          NULL};
    struct rooms_run run = {.env = env};
    int status = bench_daemon_start_with(env, options, 1, &run.daemon);
    if (status) return status;
    status = find_model(&run);
    if (!status)
        status = serve_open(env, run.daemon.address[0], NULL, 2, answered, &run, &run.crowd);
    if (!status) status = measure_rest(&run);
    if (!status) status = measure_edits(&run);
    if (!status) status = measure_open(&run);
    serve_close(&run.crowd);
    bench_daemon_stop(&run.daemon);
    return status;
}
BENCH(rooms,
      "Review rooms: opening one of 100,000 events, rooms at rest, edits from one to another",
      rooms)
