// SPDX-License-Identifier: MIT
// Sequences of frames against the daemon's rooms in this process: several clients that ask,
// cancel, hang up in the middle of a frame and do not read; bakes that end when nobody expects
// it. After each sequence nothing may be left of the clients, after each round (one life of a
// daemon) no memory. One seed makes one round.
//   fuzz_sequence [-s SECONDS] [-r SEED] [SEEDS-FOLDER]    -r: that round only
#include "answers.h"
#include "rooms.h"

#include <dirent.h>
#include <ftw.h>
#include <math.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

#include "jobs/decode_helper.h"
#include "prt/transport.h"
#include "synthetic.h"

enum { N_PEER = 4, N_BAKE = 2, MAX_SEEDS = 64, IDS = 10, SEQUENCES = 30, HANG_S = 60 };

__attribute__((weak)) void __sanitizer_set_death_callback(void (*)(void));
__attribute__((weak)) int __lsan_do_recoverable_leak_check(void);
const char *__asan_default_options(void);

const char *__asan_default_options(void)
{
    return "handle_abort=1:detect_leaks=1:exitcode=99";
}

struct peer {
    struct pipe_end end;
    struct answers answers;
    struct bytes to_send; // what the client has not sent yet
    size_t sent;
    uint64_t last_id;
    bool open, messages; // messages: frames come whole, as over WebSocket
};

static struct rnd r;
static struct world world;
static struct peer peers[N_PEER];
static struct bytes seed[MAX_SEEDS];
static unsigned n_seed;
static char folder[64], bake[N_BAKE][96];
static uint64_t round_seed;
static unsigned sequence, n_step;
static unsigned long n_frame, n_byte_answered;

static void say_where(void)
{
    fprintf(stderr,
            "in round %llu, sequence %u, step %u; repeat it with: fuzz_sequence -r %llu\n",
            (unsigned long long)round_seed, sequence, n_step, (unsigned long long)round_seed);
}

static void fail(const char *what)
{
    fprintf(stderr, "fuzz_sequence: %s\n", what);
    say_where();
    exit(1);
}

static void on_alarm(int number)
{
    fprintf(stderr, "fuzz_sequence: a sequence took more than %d s\n", HANG_S);
    abort();
}

static double now_s(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

// ---- clients

// Takes up to n bytes of what the daemon has to say.
static void read_answers(struct peer *p, size_t n)
{
    static uint8_t bytes[1 << 16];
    while (p->open && n) {
        size_t got = rooms_output(&p->end, bytes, n < sizeof bytes ? n : sizeof bytes);
        if (!got) break;
        n_byte_answered += got;
        n -= got;
        const char *wrong = answers_take(&p->answers, &world, bytes, got);
        if (wrong) fail(wrong);
    }
}

static void close_peer(struct peer *p)
{
    if (!p->open) return;
    rooms_disconnect(&p->end);
    answers_finish(&p->answers);
    free(p->to_send.at);
    *p = (struct peer){0};
}

static void ask(struct peer *p, uint16_t type, uint64_t id)
{
    if (type != RELIGHT_TYPE_VIEW_ACK && type != RELIGHT_TYPE_ROOM_PRESENCE)
        answers_ask(&p->answers, id, type);
    n_frame++;
}

// Small numbers, so that they are used again, and now and then a new one.
static uint64_t next_id(struct peer *p)
{
    if (rnd_chance(&r, 3)) return 1 + rnd(&r, IDS);
    p->last_id = p->last_id + 1 < ANSWERS_IDS - 1 ? p->last_id + 1 : 1;
    return p->last_id;
}

static void open_peer(struct peer *p, bool good)
{
    static const char *const who[] = {"uid:0", "uid:1", "uid:2", "addr:192.0.2.1"};
    *p = (struct peer){.open = true, .messages = rnd_chance(&r, 3)};
    answers_init(&p->answers);
    if (!rooms_connect(&p->end, RND_PICK(&r, who))) fail("a connection was refused");
    if (!good && rnd_chance(&r, 30)) return;
    uint64_t id = next_id(p);
    message_hello(&world, id, good, &p->to_send);
    ask(p, RELIGHT_TYPE_HELLO, id);
}

static void mutate(struct peer *p, size_t from)
{
    struct bytes *b = &p->to_send;
    uint8_t again[64];
    p->answers.exact = false; // it may ask anything now
    for (uint32_t k = 1 + rnd(&r, 4); k && b->n > from; k--) {
        size_t at = from + rnd(&r, (uint32_t)(b->n - from));
        switch (rnd(&r, 5)) {
        case 0:
            b->at[at] ^= (uint8_t)(1u << rnd(&r, 8));
            break;
        case 1:
            b->at[at] = (uint8_t)rnd(&r, 256);
            break;
        case 2:
            b->n = at; // the frame ends early
            break;
        case 3:
            memcpy(again, b->at + at, b->n - at < 64 ? b->n - at : 64);
            bytes_add(b, again, b->n - at < 64 ? b->n - at : 64);
            break;
        default: // the type, or the header's first bytes
            at = from + (rnd_chance(&r, 2) ? 6 : 32 + rnd(&r, 8));
            if (at < b->n) b->at[at] = (uint8_t)rnd(&r, 24);
        }
    }
}

static void add_requests(struct peer *p)
{
    for (uint32_t k = 1 + rnd(&r, 8); k; k--) {
        size_t from = p->to_send.n;
        if (n_seed && rnd_chance(&r, 40)) {
            const struct bytes *s = &seed[rnd(&r, n_seed)];
            bytes_add(&p->to_send, s->at, s->n);
            p->answers.exact = false;
        } else {
            uint64_t id = next_id(p);
            ask(p, message_random(&world, id, IDS, &p->to_send), id);
        }
        if (rnd_chance(&r, 30)) mutate(p, from);
    }
}

// How many bytes the next message takes, by its fixed part; all that is there where that lies.
static size_t message_size(const uint8_t *at, size_t n)
{
    uint32_t head;
    uint64_t payload;
    if (n < RELIGHT_FRAME_FIXED) return n;
    memcpy(&head, at + 16, 4);
    memcpy(&payload, at + 24, 8);
    if (head > n || payload > n) return n;
    size_t size = relight_frame_prefix_size(head, payload) + payload;
    return size < n ? size : n;
}

static void send_some(struct peer *p, bool all)
{
    static const uint32_t piece[] = {1, 31, 32, 33, 64, 100, 1000, 65536};
    size_t most = all ? SIZE_MAX : RND_PICK(&r, piece);
    while (p->sent < p->to_send.n && most && p->end.conn && p->end.reading) {
        const uint8_t *at = p->to_send.at + p->sent;
        size_t left = p->to_send.n - p->sent, n = left < most ? left : most;
        if (p->messages) n = message_size(at, left);
        // So that a sanitizer sees who looks behind the end.
        uint8_t *exact = malloc(n);
        memcpy(exact, at, n);
        if (p->messages)
            rooms_message(&p->end, exact, n, rnd_chance(&r, 2) ? SIZE_MAX : 1 + rnd(&r, 100));
        else rooms_stream(&p->end, exact, n);
        free(exact);
        p->sent += n;
        most = all ? most : p->messages ? 0 : most - n;
    }
    if (p->sent == p->to_send.n) p->sent = p->to_send.n = 0;
}

static void cancel_bake(struct peer *p, const char *job)
{
    uint64_t id = next_id(p);
    message_cancel_job(&world, id, job, &p->to_send);
    ask(p, RELIGHT_TYPE_CANCEL_JOB, id);
}

// Hundreds of bakes that end at once, then some that waited all the while: the daemon remembers
// ended ones for a while only.
static void end_many_bakes(struct peer *p)
{
    close_peer(p);
    open_peer(p, true);
    world.n_job = 0; // what ended long ago need not be asked for again
    bool fresh = true;
    for (uint32_t k = 250 + rnd(&r, 200); k && p->end.conn; k--) {
        uint64_t id = next_id(p);
        unsigned before = world.n_job;
        message_load(&world, id, fresh ? LOAD_NEW_BAKE : LOAD_SAME_BAKE, &p->to_send);
        ask(p, RELIGHT_TYPE_LOAD, id);
        send_some(p, true);
        read_answers(p, SIZE_MAX);
        rooms_turn(0);
        read_answers(p, SIZE_MAX);
        fresh = world.n_job == before || rnd_chance(&r, 50);
        if (!fresh) cancel_bake(p, world.job[world.n_job - 1]);
    }
    for (uint32_t k = rnd(&r, 16); k; k--) cancel_bake(p, world_job(&world));
    send_some(p, true);
}

// ---- bakes

static void touch_bake(void)
{
    static const char *const stage[] = {"irradiance", "single", "measuring", "no such stage",
                                        ""};
    unsigned n = rooms_bakes();
    if (!n) return;
    unsigned i = rnd(&r, n);
    switch (rnd(&r, 5)) {
    case 0:
        rooms_bake_line(i, rnd_chance(&r, 2) ? "warning: a made-up one" : "some line");
        break;
    case 1:
    case 2:
        rooms_bake_progress(i, RND_PICK(&r, stage), rnd(&r, 101) * 0.01);
        break;
    default:
        if (rnd_chance(&r, 2))
            rooms_bake_end(i, (enum rooms_end)rnd(&r, 4), bake[rnd(&r, N_BAKE)]);
    }
}

static void end_all_bakes(void)
{
    while (rooms_bakes_open()) {
        if (rooms_bakes()) rooms_bake_end(0, ROOMS_FAILED, NULL);
        rooms_turn(0);
    }
}

static void write_bakes(void)
{
    static const struct synthetic_options kind[N_BAKE] = {{.storage = PRT_STORAGE_FACTORED,
                                                           .value = PRT_VALUE_F16,
                                                           .n_cluster = 2,
                                                           .rank = 3,
                                                           .n_phase = 1,
                                                           .coefs = 6},
                                                          {.storage = PRT_STORAGE_FACTORED,
                                                           .coupling = PRT_COUPLE_FULL,
                                                           .value = PRT_VALUE_I8,
                                                           .n_cluster = 2,
                                                           .rank = 2,
                                                           .n_phase = 4,
                                                           .n_radial = 3,
                                                           .coefs = 4}};
    struct prt_context ctx;
    prt_context_init(&ctx);
    const struct prt_material medium = {.eta = 1.3f};
    for (unsigned i = 0; i < N_BAKE; i++) {
        struct prt_transport t = {.cube = 16,
                                  .n_tensor = 1,
                                  .media = {1, &medium, NULL},
                                  .engine = i ? PRT_TRANSPORT_JOINT : PRT_TRANSPORT_WAVELET,
                                  .settings = "{}",
                                  .errors = "{}"};
        struct synthetic_options o = kind[i];
        o.cube = 16;
        o.n_vertex = MODEL_VERTICES;
        o.seed = 1;
        snprintf(bake[i], sizeof bake[i], "%s/%u.prt", folder, i);
        if (synthetic_mesh(o.n_vertex, false, &t.mesh) || synthetic_tensor(&o, &t.tensor[0]) ||
            prt_file_write(&ctx, bake[i], &t))
            fail("the made-up bakes cannot be written");
        synthetic_tensor_finish(&t.tensor[0]);
        synthetic_mesh_finish(&t.mesh);
    }
}

// ---- sequences

static void settle(void)
{
    rooms_turn(0);
    while (rooms_working()) rooms_turn(20);
    rooms_turn(0);
}

// Every request but views and watches comes to its answer while its client listens.
static void expect_answers(void)
{
    double patience = now_s() + 30;
    for (;;) {
        for (int i = 0; i < N_PEER; i++) read_answers(&peers[i], SIZE_MAX);
        if (rooms_requests() == rooms_long_requests()) break;
        if (now_s() > patience) fail("a request was never answered");
        rooms_turn(20);
        // A view or a load may wait for what a bake does.
        if (now_s() > patience - 20) end_all_bakes();
    }
    for (int i = 0; i < N_PEER; i++) {
        const struct peer *p = &peers[i];
        if (!p->open || !p->end.conn || !p->answers.exact || p->sent != p->to_send.n) continue;
        unsigned asked = 0, ended = 0;
        for (unsigned id = 0; id < ANSWERS_IDS; id++) {
            asked += p->answers.asked[id];
            ended += p->answers.ended[id];
        }
        if (asked - ended > rooms_long_requests()) fail("a request ended without an answer");
    }
}

static void one_step(void)
{
    struct peer *p = &peers[rnd(&r, N_PEER)];
    uint32_t what = rnd(&r, 16);
    if (!p->open) open_peer(p, false);
    if (what < 7) {
        add_requests(p);
        if (!rnd_chance(&r, 4)) send_some(p, true);
    } else if (what < 9) {
        send_some(p, rnd_chance(&r, 3));
    } else if (what < 11) {
        touch_bake();
    } else if (what == 11 && rnd_chance(&r, 3)) {
        close_peer(p);
    } else if (what == 12 && rnd_chance(&r, 20)) {
        rooms_expire();
    } else if (what == 13) {
        rooms_refuse_bakes(rnd_chance(&r, 8));
    } else if (what == 14 && rnd_chance(&r, 30)) {
        end_many_bakes(p);
    }
    if (rnd_chance(&r, 2)) rooms_turn(rnd_chance(&r, 8) ? 2 : 0);
    for (int i = 0; i < N_PEER; i++) {
        if (rnd_chance(&r, 4)) continue; // a slow reader
        read_answers(&peers[i], rnd_chance(&r, 6) ? rnd(&r, 3000) : SIZE_MAX);
        if (peers[i].open && !peers[i].end.conn && rnd_chance(&r, 2)) close_peer(&peers[i]);
    }
}

static void one_sequence(void)
{
    alarm(HANG_S);
    uint32_t steps = 5 + rnd(&r, 40);
    for (n_step = 0; n_step < steps; n_step++) one_step();
    rooms_refuse_bakes(false);
    if (rnd_chance(&r, 3)) expect_answers();
    bool bakes_first = rnd_chance(&r, 2);
    if (bakes_first) end_all_bakes();
    for (int i = 0; i < N_PEER; i++) close_peer(&peers[i]);
    if (!bakes_first) end_all_bakes();
    settle();
    // A model that is being read or opened lives on for that while, and its vertices with it.
    const char *left = rooms_leftover();
    for (double end = now_s() + 20; left && now_s() < end; left = rooms_leftover())
        rooms_turn(20);
    if (left) {
        fprintf(stderr, "all clients have gone and this is left: %s\n", left);
        fail("something is left");
    }
    alarm(0);
}

// Uploads what models are made of, so that most sequences have them.
static void prepare(void)
{
    struct peer *p = &peers[0];
    open_peer(p, true);
    for (unsigned b = 0; b < WORLD_BLOBS; b++)
        for (int twice = 0; twice < 2; twice++) {
            uint64_t id = next_id(p);
            message_upload(&world, id, b, &p->to_send);
            ask(p, RELIGHT_TYPE_PUT_BLOB, id);
        }
    send_some(p, true);
    read_answers(p, SIZE_MAX);
    close_peer(p);
}

static int remove_one(const char *path, const struct stat *st, int kind, struct FTW *where)
{
    return remove(path);
}

static void one_round(uint64_t number, double end_s)
{
    static const uint64_t send_buffer[] = {64 << 20, 1 << 20, 4096, 300};
    static const uint64_t cache[] = {64 << 20, 1 << 20, 1};
    char data[96];
    round_seed = number;
    rnd_seed(&r, number);
    snprintf(data, sizeof data, "%s/%llu", folder, (unsigned long long)number);
    struct rooms_settings settings = {
        .data = data,
        .threads = 1 + rnd(&r, 2),
        .requests = rnd_chance(&r, 4) ? 6 : 256,
        .queue = rnd_chance(&r, 6) ? 12 : 4096,
        .bakes = 1 + rnd(&r, 2),
        .bake_queue = rnd_chance(&r, 6) ? 2 : 64,
        .cache = RND_PICK(&r, cache),
        .memory = RND_PICK(&r, cache),
        .disk = rnd_chance(&r, 6) ? 20000 : 1 << 30,
        .send_buffer = rnd_chance(&r, 2) ? 64 << 20 : RND_PICK(&r, send_buffer),
        .idle_s = rnd_chance(&r, 4) ? 0.005 : 600,
        .frame_time_s = rnd_chance(&r, 4) ? 0.005 : 30};
    world_init(&world, &r);
    mkdir(data, 0700);
    bool again = rnd_chance(&r, 3); // the daemon is started anew on the same folder
    for (unsigned life = 0; life < 1u + again; life++) {
        world_forget(&world);
        if (!rooms_start(&settings)) fail("the rooms cannot be opened");
        prepare();
        for (unsigned i = 0; i < SEQUENCES / (again ? 2 : 1) && now_s() < end_s;
             i++, sequence++)
            one_sequence();
        rooms_stop();
    }
    if (__lsan_do_recoverable_leak_check && __lsan_do_recoverable_leak_check())
        fail("memory is lost");
    nftw(data, remove_one, 16, FTW_DEPTH | FTW_PHYS);
}

static void read_seeds(const char *path)
{
    struct dirent **list = NULL;
    char name[4096];
    int n_file = scandir(path, &list, NULL, alphasort);
    for (int i = 0; i < n_file; free(list[i++])) {
        const char *dot = strrchr(list[i]->d_name, '.');
        if (!dot || strcmp(dot, ".bin") || n_seed == MAX_SEEDS) continue;
        snprintf(name, sizeof name, "%s/%s", path, list[i]->d_name);
        FILE *file = fopen(name, "rb");
        uint8_t bytes[4096];
        for (size_t n; file && (n = fread(bytes, 1, sizeof bytes, file)) > 0;)
            bytes_add(&seed[n_seed], bytes, n);
        if (file) fclose(file);
        n_seed++;
    }
    free(list);
}

int main(int argc, char **argv)
{
    if (argc == 3 && !strcmp(argv[1], "--decode-helper"))
        return decode_helper_main(atoi(argv[2]));
    double seconds = 5;
    uint64_t only = 0;
    int option;
    while ((option = getopt(argc, argv, "s:r:")) != -1) {
        if (option == 's') seconds = atof(optarg);
        else if (option == 'r') only = strtoull(optarg, NULL, 0);
        else return 2;
    }
    if (optind < argc) read_seeds(argv[optind]);
    signal(SIGPIPE, SIG_IGN);
    signal(SIGALRM, on_alarm);
    if (__sanitizer_set_death_callback) __sanitizer_set_death_callback(say_where);
    strcpy(folder, "/tmp/relight-fuzz-XXXXXX");
    if (!mkdtemp(folder)) return perror(folder), 1;
    write_bakes();
    double start = now_s();
    unsigned rounds = 0;
    do {
        one_round(only ? only : 1 + rounds, only ? INFINITY : start + seconds);
        rounds++;
    } while (!only && now_s() - start < seconds);
    nftw(folder, remove_one, 16, FTW_DEPTH | FTW_PHYS);
    for (unsigned i = 0; i < n_seed; i++) free(seed[i].at);
    printf("%u rounds, %u sequences, %lu frames, %lu bytes of answers in %.1f s\n", rounds,
           sequence, n_frame, n_byte_answered, now_s() - start);
    return 0;
}
