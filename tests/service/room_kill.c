// SPDX-License-Identifier: MIT
// Fifty clients edit one room, twenty times a second each, while the daemon is killed five
// times: every client ends with the same state, and no edit that was acknowledged is lost or
// done twice. ROOM_SECONDS in the environment: for how long (10).
#include "room_frames.h"

#include "lone_daemon.h"

#include "rooms/fold.h"

enum { CLIENTS = 50, RATE = 20, KILLS = 5, MOST = 4000 };

static char room[33];

struct person {
    struct frames *f; // NULL: not connected
    char name[16], client[17];
    Relight__RoomState *state; // its replica, NULL before the first
    uint64_t sent, acked;      // numbers of edits: one is under way at a time
    double next_s;
    bool waiting; // for the answer to `sent`
    unsigned resumed, snapshots;
};
static struct person people[CLIENTS];

static double now_s(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static int try_connect(void)
{
    struct sockaddr_un to = {.sun_family = AF_UNIX};
    int fd = socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0);
    snprintf(to.sun_path, sizeof to.sun_path, "%s", d.socket);
    if (!connect(fd, (struct sockaddr *)&to, sizeof to)) return fd;
    close(fd);
    return -1;
}

static void add_edit(struct person *p)
{
    Relight__Light light = RELIGHT__LIGHT__INIT, *lights[] = {&light};
    Relight__Scene scene = RELIGHT__SCENE__INIT;
    Relight__SceneChange change = RELIGHT__SCENE_CHANGE__INIT;
    Relight__PutVariant variant = RELIGHT__PUT_VARIANT__INIT;
    Relight__RoomAction action = RELIGHT__ROOM_ACTION__INIT;
    char *parts[] = {"lights"}, material[40];
    light.env = "constant";
    light.rotate_deg = (float)p->sent;
    scene.lights = lights;
    scene.n_lights = 1;
    change.scene = &scene;
    change.parts = parts;
    change.n_parts = 1;
    variant.name = p->name;
    variant.material = material;
    snprintf(material, sizeof material, "%llu", (unsigned long long)p->sent);
    if (p->sent & 1) action.variant = &variant; // one's own
    else action.scene = &change;                // everybody's
    room_add_edit(p->f, 100 + p->sent, room, &action, p->name, p->client, p->sent);
}

// HELLO, the seat from its cursor on, and the edit whose answer is missing.
static void come_back(struct person *p)
{
    int fd = try_connect();
    if (fd < 0) return;
    struct relight_frame_limits limits = {1 << 24, UINT64_C(1) << 32, false};
    p->f = calloc(1, sizeof *p->f);
    relight_decoder_init(&p->f->decoder, &limits);
    p->f->fd = fd;
    frames_add_hello(p->f, p->name);
    room_add_subscribe(p->f, 2, room, p->state ? p->state->sequence : 0, p->name);
    if (p->waiting) add_edit(p);
    p->resumed++;
    frames_try_send(p->f);
}

static void lose(struct person *p)
{
    frames_close(p->f);
    p->f = NULL;
}

static void take_events(struct person *p, const struct reply *r)
{
    char error[ROOM_ERROR];
    const Relight__Event *e = (Relight__Event *)r->message;
    if (e->kind == RELIGHT__EVENT_KIND__EVENT_ROOM_STATE) {
        room_state_free(p->state);
        p->state = relight__room_state__unpack(NULL, r->n, r->payload);
        p->snapshots++;
    }
    if (e->kind != RELIGHT__EVENT_KIND__EVENT_ROOM_EVENTS) return;
    Relight__RoomEvents *all = relight__room_events__unpack(NULL, r->n, r->payload);
    for (size_t i = 0; i < all->n_events; i++)
        if (room_fold(p->state, all->events[i], error)) fail_msg("%s: %s", p->name, error);
    relight__room_events__free_unpacked(all, NULL);
}

static void take_answer(struct person *p, const struct reply *r, uint64_t id)
{
    if (id != 100 + p->sent || !p->waiting) return;
    if (r->code == RELIGHT__ERROR_CODE__ERROR_BUSY) { // it is being written: ask again
        add_edit(p);
        frames_try_send(p->f);
        return;
    }
    if (r->code == RELIGHT__ERROR_CODE__ERROR_SHUTTING_DOWN) return;
    if (r->code) fail_msg("%s: %d %s", p->name, r->code, r->text);
    p->waiting = false;
    p->acked = p->sent;
}

// Everything that has arrived.
static void listen_to(struct person *p)
{
    struct reply r;
    uint64_t id;
    while (p->f && reply_next(p->f, 0, 0, &r, &id)) {
        if (r.closed) lose(p);
        else if (id == 2 && !r.code) take_events(p, &r);
        else take_answer(p, &r, id);
        reply_free(&r);
    }
}

static void act(struct person *p, double now)
{
    if (!p->f) come_back(p);
    if (!p->f || !p->state || p->waiting || now < p->next_s) return;
    p->next_s += 1.0 / RATE;
    if (p->next_s < now) p->next_s = now;
    p->sent++;
    p->waiting = true;
    add_edit(p);
    if (!frames_try_send(p->f)) lose(p);
}

// daemon_start, while the clients go on trying.
static void restart(void)
{
    kill(d.pid, SIGKILL);
    waitpid(d.pid, NULL, 0);
    d.pid = daemon_spawn(&d, NULL);
}

static void run_for(double seconds)
{
    double begin = now_s(), end = begin + seconds;
    int kills = 0;
    for (double now; (now = now_s()) < end;) {
        struct pollfd wait[CLIENTS];
        nfds_t n = 0;
        if (kills < KILLS && now > begin + seconds * (kills + 1) / (KILLS + 1)) {
            restart();
            kills++;
        }
        for (int i = 0; i < CLIENTS; i++) {
            act(&people[i], now);
            if (people[i].f) wait[n++] = (struct pollfd){people[i].f->fd, POLLIN, 0};
        }
        poll(wait, n, 5);
        for (int i = 0; i < CLIENTS; i++) listen_to(&people[i]);
    }
    assert_int_equal(kills, KILLS);
}

static bool settled(uint64_t sequence)
{
    for (int i = 0; i < CLIENTS; i++) {
        const struct person *p = &people[i];
        if (!p->f || p->waiting || !p->state || p->state->sequence < sequence) return false;
    }
    return true;
}

static void settle(struct frames **f, char hash[65])
{
    uint64_t sequence = UINT64_MAX;
    double patience = now_s() + 60;
    for (int round = 0; !settled(sequence); round++) {
        if (now_s() > patience) fail_msg("the clients do not come to rest");
        for (int i = 0; i < CLIENTS; i++) {
            people[i].next_s = 1e18;
            act(&people[i], 0);
            listen_to(&people[i]);
        }
        sleep_ms(5);
        bool quiet = true;
        for (int i = 0; i < CLIENTS; i++) quiet &= people[i].f && !people[i].waiting;
        if (!quiet) continue;
        if (!*f) *f = frames_open(&d);
        Relight__RoomState *s = room_state(*f, room, hash, NULL);
        sequence = s->sequence;
        relight__room_state__free_unpacked(s, NULL);
    }
}

// Counts each client's numbers in the log: 1 to acked, each once.
static void check_log(struct frames *f)
{
    static uint8_t seen[CLIENTS][MOST];
    Relight__RoomGetRequest m = RELIGHT__ROOM_GET_REQUEST__INIT;
    uint64_t total = 0, acked = 0;
    m.room = room;
    m.events = true;
    for (bool more = true; more;) {
        frames_add(f, RELIGHT_TYPE_ROOM_GET, 7, &m.base, NULL, 0);
        frames_send(f);
        struct reply r = reply_to(f, 7);
        assert_int_equal(r.code, 0);
        Relight__RoomEvents *all = relight__room_events__unpack(NULL, r.n, r.payload);
        for (size_t i = 0; i < all->n_events; i++) {
            const Relight__RoomEvent *e = all->events[i];
            assert_int_equal(e->stamp->sequence, m.after + i + 1);
            if (!*e->client) continue;
            unsigned who = (unsigned)strtoul(e->client, NULL, 16);
            assert_true(who < CLIENTS && e->number < MOST);
            seen[who][e->number]++;
            total++;
        }
        more = all->n_events;
        m.after += all->n_events;
        relight__room_events__free_unpacked(all, NULL);
        reply_free(&r);
    }
    for (unsigned i = 0; i < CLIENTS; i++) {
        acked += people[i].acked;
        for (uint64_t n = 1; n <= people[i].acked; n++)
            if (seen[i][n] != 1)
                fail_msg("edit %d of client %u is there %d times", (int)n, i, seen[i][n]);
    }
    assert_int_equal(total, acked);
}

static void killed_while_fifty_edit(void **unused)
{
    const char *seconds = getenv("ROOM_SECONDS");
    char hash[65], own[65];
    daemon_folder(&d);
    daemon_start(&d, NULL);
    struct frames *f = frames_open(&d);
    room_create(f, "fifty", room);
    frames_close(f);
    f = NULL;
    for (int i = 0; i < CLIENTS; i++) {
        snprintf(people[i].name, sizeof people[i].name, "p%d", i);
        snprintf(people[i].client, sizeof people[i].client, "%016x", i);
        people[i].next_s = now_s() + i * (1.0 / RATE / CLIENTS);
    }
    run_for(seconds ? atof(seconds) : 10);
    settle(&f, hash);
    uint64_t acked = 0;
    unsigned resumed = 0, snapshots = 0;
    for (int i = 0; i < CLIENTS; i++) {
        assert_true(room_state_hash(people[i].state, own));
        assert_string_equal(own, hash);
        acked += people[i].acked;
        resumed += people[i].resumed;
        snapshots += people[i].snapshots;
    }
    print_message("%llu edits acknowledged, %u connections, %u snapshots, state %.12s\n",
                  (unsigned long long)acked, resumed, snapshots, hash);
    assert_true(resumed >= CLIENTS * (KILLS - 1));
    check_log(f);
    for (int i = 0; i < CLIENTS; i++) {
        lose(&people[i]);
        room_state_free(people[i].state);
    }
    frames_close(f);
    end();
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_teardown(killed_while_fifty_edit, teardown),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
