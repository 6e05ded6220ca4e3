// SPDX-License-Identifier: MIT
// A client's connection: one socket, many requests, no thread of its own. Of the waiting
// threads one, the leader, polls the socket and stores answers in their slots. The others wait
// on a condition until their slot is filled or there is no leader. Above 600 lines: socket,
// slots and leadership share one lock, whose order a split would hide.
#include "internal.h"
#include "tls.h"

#include <errno.h>
#include <math.h>
#include <poll.h>
#include <stdarg.h>
#include <stdio.h>
#include <sys/eventfd.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

enum { N_BUCKET = 64, READ_SIZE = 1 << 16 };
static const double grace_s = 1.0; // the daemon's own "deadline passed" should arrive first

struct slot {
    struct slot *next; // in its bucket
    uint64_t id;
    double deadline_s; // when its caller gives up; INFINITY none
    bool last;         // its last answer is queued
    bool forgotten;    // nobody waits: drop answers, free at the last one
    bool lost;         // its connection ended: no further answer comes
    struct answer *head, **tail;
    struct answer *part; // message whose payload is still coming (MORE)
    uint64_t part_room;
};

struct out_item { // lives on the stack of the thread that sends
    struct out_item *next;
    const struct iovec *piece;
    int n_piece, at;
    size_t at_offset;
    bool done;
};

struct relight_client {
    pthread_mutex_t lock; // everything below
    pthread_cond_t changed;
    int fd, wake_fd;
    struct relight_tls *tls; // NULL: plain text
    bool leading;            // some thread polls
    bool lead_writes;        // and waits for POLLOUT as well
    bool broken;
    struct relight_error fault; // why
    uint64_t next_id;
    struct slot *bucket[N_BUCKET];
    struct out_item *out_head, **out_tail;
    struct relight_decoder decoder;
    uint8_t *read_buffer;
    double timeout_s;
    struct relight_server server;
    char *address;
    struct answer *hello; // the last one; earlier ones behind it, for relight_server()
    bool gone_away;
    struct relight_goaway goaway;
    char *name, *token, *ca, *route; // for a reconnect; route "": none
    bool stay;                       // where the daemon that is asked serves
    double connect_timeout_s, reconnect_s;
    bool reviving; // `reviver` connects again, others wait
    pthread_t reviver;
};

// An error's text may come from the daemon and is printed to terminals: control characters (C0,
// DEL, and C1 in UTF-8) become '?', and a character that the array cut is dropped.
static void tidy_line(char *text, size_t room)
{
    size_t n = strlen(text), last = n;
    for (size_t i = 0; i < n; i++) {
        unsigned char c = (unsigned char)text[i], next = (unsigned char)text[i + 1];
        if (c < 0x20 || c == 0x7f) text[i] = '?';
        if (c == 0xc2 && next >= 0x80 && next < 0xa0) text[i] = text[i + 1] = '?';
    }
    if (n + 1 < room) return;
    while (last && ((unsigned char)text[last - 1] & 0xc0) == 0x80) last--;
    if (!last || (unsigned char)text[last - 1] < 0xc0) return;
    unsigned char lead = (unsigned char)text[last - 1];
    size_t needed = lead < 0xe0 ? 2 : lead < 0xf0 ? 3 : 4;
    if (n - (last - 1) < needed) text[last - 1] = 0;
}

int relight_fail(struct relight_error *error, int code, const char *hint, const char *fmt, ...)
{
    if (!error) return -code;
    *error = (struct relight_error){.code = code};
    va_list list;
    va_start(list, fmt);
    vsnprintf(error->text, sizeof error->text, fmt, list);
    va_end(list);
    snprintf(error->hint, sizeof error->hint, "%s", hint);
    tidy_line(error->text, sizeof error->text);
    tidy_line(error->hint, sizeof error->hint);
    return -code;
}

int relight_fail_message(struct relight_error *error, const Relight__Error *message)
{
    int code = (int)message->code;
    if (code <= 0 || code >= 100) code = RELIGHT_E_INTERNAL;
    relight_fail(error, code, message->hint, "%s",
                 *message->text ? message->text : relight_code_text(code));
    if (!error) return -code;
    error->retry_after_ms = message->retry_after_ms;
    error->has_range = message->has_range;
    error->minimum = message->minimum;
    error->maximum = message->maximum;
    error->generation = message->generation;
    snprintf(error->parameter, sizeof error->parameter, "%s", message->parameter);
    snprintf(error->unit, sizeof error->unit, "%s", message->unit);
    snprintf(error->address, sizeof error->address, "%s", message->address);
    tidy_line(error->address, sizeof error->address);
    tidy_line(error->parameter, sizeof error->parameter);
    tidy_line(error->unit, sizeof error->unit);
    return -code;
}

const char *relight_code_text(int code)
{
    switch (code < 0 ? -code : code) {
#define X(name, number, text) \
    case number:              \
        return text;
        RELIGHT_CODE_LIST(X)
#undef X
    default:
        return "unknown error";
    }
}

// c->fault has the reason.
static void hang_up(struct relight_client *c)
{
    c->broken = true;
    shutdown(c->fd, SHUT_RDWR);
    for (struct out_item *o = c->out_head; o; o = o->next) o->done = true;
    for (int i = 0; i < N_BUCKET; i++)
        for (struct slot *s = c->bucket[i]; s; s = s->next) s->lost = true;
    c->out_head = NULL;
    c->out_tail = &c->out_head;
    pthread_cond_broadcast(&c->changed);
}

static void break_connection(struct relight_client *c, int code, const char *text)
{
    if (c->broken) return;
    relight_fail(&c->fault, code, "connect again", "%s: %s", c->address, text);
    hang_up(c);
}

static int broken(const struct relight_client *c, struct relight_error *error)
{
    if (error) *error = c->fault;
    return -c->fault.code;
}

void relight_answer_free(struct answer *answer)
{
    if (!answer) return;
    if (answer->message) protobuf_c_message_free_unpacked(answer->message, NULL);
    free(answer->payload);
    free(answer);
}

static struct slot **find_slot(struct relight_client *c, uint64_t id)
{
    struct slot **at = &c->bucket[id % N_BUCKET];
    while (*at && (*at)->id != id) at = &(*at)->next;
    return at;
}

static struct slot *add_slot(struct relight_client *c, double deadline_s, bool forgotten)
{
    struct slot *slot = calloc(1, sizeof *slot);
    if (!slot) return NULL;
    slot->id = c->next_id++;
    slot->tail = &slot->head;
    slot->deadline_s = deadline_s;
    slot->forgotten = forgotten;
    slot->next = c->bucket[slot->id % N_BUCKET];
    c->bucket[slot->id % N_BUCKET] = slot;
    return slot;
}

static void free_slot(struct slot *slot)
{
    for (struct answer *a = slot->head, *next; a; a = next) {
        next = a->next;
        relight_answer_free(a);
    }
    relight_answer_free(slot->part);
    free(slot);
}

static void drop_slot(struct relight_client *c, uint64_t id)
{
    struct slot **at = find_slot(c, id), *slot = *at;
    if (!slot) return;
    *at = slot->next;
    free_slot(slot);
}

// Appends a frame's payload to the unfinished message.
static int append_part(struct relight_client *c, struct slot *slot, uint8_t *bytes, uint64_t n)
{
    struct answer *part = slot->part;
    uint64_t total;
    if (__builtin_add_overflow(part->payload_size, n, &total) ||
        total > c->decoder.limits.max_payload)
        return -1;
    if (total > slot->part_room) {
        uint64_t room = total > slot->part_room * 2 ? total : slot->part_room * 2;
        void *more;
        if (posix_memalign(&more, RELIGHT_FRAME_ALIGN, (size_t)room)) return -1;
        if (part->payload_size) memcpy(more, part->payload, (size_t)part->payload_size);
        free(part->payload);
        part->payload = more;
        slot->part_room = room;
    }
    if (n) memcpy(part->payload + part->payload_size, bytes, (size_t)n);
    part->payload_size = total;
    return 0;
}

static const char *take_goaway(struct relight_client *c, const struct relight_frame *f)
{
    Relight__Goaway *m = (Relight__Goaway *)relight_frame_unpack(f);
    if (!m) return "the server's GOAWAY does not parse";
    c->gone_away = true;
    c->goaway.drain_s = m->drain_ms * 1e-3;
    snprintf(c->goaway.address, sizeof c->goaway.address, "%s", m->address);
    snprintf(c->goaway.text, sizeof c->goaway.text, "%s", m->text);
    tidy_line(c->goaway.address, sizeof c->goaway.address);
    tidy_line(c->goaway.text, sizeof c->goaway.text);
    protobuf_c_message_free_unpacked(&m->base, NULL);
    return NULL;
}

bool relight_goaway(struct relight_client *client, struct relight_goaway *out)
{
    pthread_mutex_lock(&client->lock);
    bool gone_away = client->gone_away;
    if (gone_away && out) *out = client->goaway;
    pthread_mutex_unlock(&client->lock);
    return gone_away;
}

bool relight_reconnects(const struct relight_client *client)
{
    return client->reconnect_s > 0;
}

static const char *deliver(struct relight_client *c)
{
    struct relight_frame *f = &c->decoder.frame;
    if (!(f->type & RELIGHT_TYPE_ANSWER)) return "the server sent a request";
    struct slot *slot = *find_slot(c, f->id);
    if (f->type == RELIGHT_TYPE_GOAWAY) return take_goaway(c, f);
    if (!slot) {
        if (f->id || f->type != RELIGHT_TYPE_ERROR) return NULL; // late answer, nobody asks
        ProtobufCMessage *message = relight_frame_unpack(f);
        if (!message) return "the server's error does not parse";
        relight_fail_message(&c->fault, (Relight__Error *)message);
        protobuf_c_message_free_unpacked(message, NULL);
        hang_up(c);
        return NULL;
    }
    struct answer *answer = slot->part;
    if (answer) {
        if (f->header_size || f->type != answer->type) return "a continued message is mixed up";
        if (append_part(c, slot, f->payload, f->payload_size)) return "an answer is too large";
    } else {
        if (!(answer = calloc(1, sizeof *answer))) return "not enough memory";
        answer->type = f->type;
        answer->payload_size = f->payload_size;
        answer->payload = relight_decoder_take(&c->decoder);
        slot->part = answer;
        slot->part_room = f->payload_size;
        if (!(answer->message = relight_frame_unpack(f)))
            return "an answer's header does not parse";
    }
    if (f->flags & RELIGHT_FRAME_MORE) return NULL;
    answer->last = f->flags & RELIGHT_FRAME_LAST || f->type == RELIGHT_TYPE_ERROR;
    slot->part = NULL;
    slot->last = answer->last;
    *slot->tail = answer;
    slot->tail = &answer->next;
    if (slot->forgotten) {
        // Nobody will read it; keep the slot, so that continuations are understood, to the end.
        slot->head = NULL;
        slot->tail = &slot->head;
        bool last = answer->last;
        relight_answer_free(answer);
        if (last) drop_slot(c, f->id);
    }
    return NULL;
}

// Reads the socket until it is empty or a frame is complete.
static void read_some(struct relight_client *c)
{
    // What TLS has decrypted already is not reported by the socket.
    for (bool got_frame = false;
         !c->broken && (!got_frame || (c->tls && relight_tls_pending(c->tls)));) {
        size_t room;
        uint8_t *to = relight_decoder_space(&c->decoder, &room);
        bool direct = to && room >= READ_SIZE;
        uint8_t *into = direct ? to : c->read_buffer;
        size_t most = direct ? room : READ_SIZE;
        ssize_t n = c->tls ? relight_tls_read(c->tls, into, most) : recv(c->fd, into, most, 0);
        if (n < 0 && errno == EINTR) continue;
        if (n < 0 && (errno == EAGAIN || errno == EWOULDBLOCK)) return;
        if (n <= 0) {
            break_connection(c, RELIGHT_E_DISCONNECTED,
                             n ? strerror(errno) : "the server closed the connection");
            return;
        }
        const uint8_t *at = c->read_buffer;
        size_t left = direct ? 0 : (size_t)n, used;
        int status = direct ? relight_decoder_commit(&c->decoder, (size_t)n)
                            : relight_decoder_feed(&c->decoder, at, left, &used);
        for (;;) {
            const char *bad = NULL;
            if (status < 0) bad = relight_frame_fault_text(status);
            else if (status > 0) {
                bad = deliver(c);
                got_frame = true;
                int next = relight_decoder_commit(&c->decoder, 0); // free the frame
                (void)next;
            }
            if (bad) {
                break_connection(c, RELIGHT_E_PROTOCOL, bad);
                return;
            }
            if (direct) break;
            at += used;
            left -= used;
            if (!left) break;
            status = relight_decoder_feed(&c->decoder, at, left, &used);
        }
    }
}

static void write_some(struct relight_client *c)
{
    while (c->out_head && !c->broken) {
        struct out_item *o = c->out_head;
        struct iovec vec[32];
        int n = 0;
        for (int i = o->at; i < o->n_piece && n < 32; i++, n++) {
            vec[n] = o->piece[i];
            if (i == o->at) {
                vec[n].iov_base = (char *)vec[n].iov_base + o->at_offset;
                vec[n].iov_len -= o->at_offset;
            }
        }
        struct msghdr message = {.msg_iov = vec, .msg_iovlen = (size_t)n};
        ssize_t put =
            c->tls ? relight_tls_write(c->tls, vec, n) : sendmsg(c->fd, &message, MSG_NOSIGNAL);
        if (put < 0 && errno == EINTR) continue;
        if (put < 0 && (errno == EAGAIN || errno == EWOULDBLOCK)) return;
        if (put < 0) {
            // An answer from before the close explains more than "broken pipe".
            int code = errno;
            read_some(c);
            break_connection(c, RELIGHT_E_DISCONNECTED, strerror(code));
            return;
        }
        size_t left = (size_t)put + o->at_offset;
        while (o->at < o->n_piece && left >= o->piece[o->at].iov_len)
            left -= o->piece[o->at++].iov_len;
        o->at_offset = left;
        if (o->at < o->n_piece) continue;
        o->done = true;
        if (!(c->out_head = o->next)) c->out_tail = &c->out_head;
        pthread_cond_broadcast(&c->changed);
    }
}

static void wake_leader(struct relight_client *c)
{
    uint64_t one = 1;
    (void)!write(c->wake_fd, &one, sizeof one);
}

// One step: leads (poll, read, write) or waits for the leader. Lock held; false at `end_s`.
static bool turn(struct relight_client *c, double end_s)
{
    double left = end_s - relight_now_s();
    if (left <= 0) return false;
    if (left > 3600) left = 3600;
    if (c->leading) {
        struct timespec t;
        clock_gettime(CLOCK_MONOTONIC, &t);
        double at = (double)t.tv_nsec * 1e-9 + left, whole = floor(at);
        t.tv_sec += (time_t)whole;
        t.tv_nsec = (long)((at - whole) * 1e9);
        pthread_cond_timedwait(&c->changed, &c->lock, &t);
        return true;
    }
    c->leading = true;
    c->lead_writes = c->out_head != NULL;
    struct pollfd p[2] = {
        {.fd = c->fd, .events = (short)(POLLIN | (c->lead_writes ? POLLOUT : 0))},
        {.fd = c->wake_fd, .events = POLLIN}};
    pthread_mutex_unlock(&c->lock);
    int n = poll(p, 2, (int)(left * 1e3) + 1);
    pthread_mutex_lock(&c->lock);
    if (n > 0 && p[1].revents) {
        uint64_t drained;
        (void)!read(c->wake_fd, &drained, sizeof drained);
    }
    if (n > 0 && p[0].revents && !c->broken) {
        if (p[0].revents & (POLLIN | POLLHUP | POLLERR)) read_some(c);
        if (c->out_head) write_some(c);
    }
    c->leading = false;
    pthread_cond_broadcast(&c->changed);
    return true;
}

double relight_timeout(const struct relight_client *client)
{
    return client->timeout_s;
}

// True while answers are still to come on this connection.
static bool has_open_slots(const struct relight_client *c)
{
    for (int i = 0; i < N_BUCKET; i++)
        for (const struct slot *s = c->bucket[i]; s; s = s->next)
            if (!s->lost && !s->last) return true;
    return false;
}

static int hello(struct relight_client *c, struct relight_error *error);

// A connected socket, with TLS where the address says so; or -code.
static int open_transport(const char *address, const char *ca, double timeout_s,
                          struct relight_tls **tls, struct relight_error *error)
{
    char host[256];
    *tls = NULL;
    int fd = relight_socket(address, timeout_s, host, error);
    int status = fd >= 0 && *host ? relight_tls_open(fd, host, ca, timeout_s, tls, error) : 0;
    if (!status) return fd;
    close(fd);
    return status;
}

// One attempt. The lock is held, and is free while it connects.
static int connect_again(struct relight_client *c, const char *address,
                         struct relight_error *error)
{
    pthread_mutex_unlock(&c->lock);
    struct relight_tls *tls;
    int fd = open_transport(address, c->ca, c->connect_timeout_s, &tls, error);
    pthread_mutex_lock(&c->lock);
    if (fd < 0) return fd;
    struct relight_frame_limits limits = c->decoder.limits;
    relight_tls_close(c->tls);
    close(c->fd);
    c->fd = fd;
    c->tls = tls;
    relight_decoder_finish(&c->decoder);
    relight_decoder_init(&c->decoder, &limits);
    c->broken = c->gone_away = false;
    pthread_mutex_unlock(&c->lock);
    int status = hello(c, error);
    pthread_mutex_lock(&c->lock);
    if (status && !c->broken) break_connection(c, RELIGHT_E_DISCONNECTED, "HELLO failed");
    while (status && c->leading) pthread_cond_wait(&c->changed, &c->lock);
    return status;
}

// Connects, and goes where the daemon sends it: once, so that no two send it to and fro. Where
// nobody answers there, the first one serves. Lock held.
static int connect_routed(struct relight_client *c, const char *address,
                          struct relight_error *error)
{
    struct relight_error own;
    struct relight_error *e = error ? error : &own;
    c->stay = false;
    int status = connect_again(c, address, e);
    if (status != -RELIGHT_E_MOVED) return status;
    char moved[sizeof e->address];
    memcpy(moved, e->address, sizeof moved);
    c->stay = true;
    status = *moved ? connect_again(c, moved, e) : -RELIGHT_E_UNREACHABLE;
    return status ? connect_again(c, address, e) : 0;
}

// Connects again where the connection is lost, or where the daemon said GOAWAY and no answer is
// still to come. Lock held.
static int revive(struct relight_client *c, struct relight_error *error)
{
    if (c->reviving && pthread_equal(c->reviver, pthread_self())) return 0; // its HELLO
    while (c->reviving) pthread_cond_wait(&c->changed, &c->lock);
    // The end of the stream, or a GOAWAY, may have arrived since the last read.
    struct pollfd p = {c->fd, POLLIN, 0};
    while (!c->broken && !c->leading && poll(&p, 1, 0) > 0) read_some(c);
    if (!c->broken && (!c->gone_away || has_open_slots(c))) return 0;
    char address[128];
    snprintf(address, sizeof address, "%s",
             c->gone_away && c->goaway.address[0] ? c->goaway.address : c->address);
    break_connection(c, RELIGHT_E_DISCONNECTED, "the server is stopping");
    c->reviving = true;
    c->reviver = pthread_self();
    while (c->leading) pthread_cond_wait(&c->changed, &c->lock);
    double end = relight_now_s() + c->reconnect_s, pause_s = 0.05;
    int status;
    while ((status = connect_routed(c, address, error)) == -RELIGHT_E_UNREACHABLE ||
           status == -RELIGHT_E_DISCONNECTED || status == -RELIGHT_E_TIMEOUT ||
           status == -RELIGHT_E_BUSY || status == -RELIGHT_E_SHUTTING_DOWN) {
        if (relight_now_s() + pause_s > end) break;
        pthread_mutex_unlock(&c->lock);
        struct timespec pause = {(time_t)pause_s, (long)(fmod(pause_s, 1) * 1e9)};
        nanosleep(&pause, NULL);
        pause_s = fmin(2 * pause_s, 1);
        pthread_mutex_lock(&c->lock);
    }
    c->reviving = false;
    pthread_cond_broadcast(&c->changed);
    return status;
}

int relight_start(struct relight_client *c, uint16_t type, const ProtobufCMessage *message,
                  const struct iovec *payload, int n_payload, double deadline_s, bool forget,
                  uint64_t *id, struct relight_error *error)
{
    struct relight_frame frame = {.type = type, .flags = RELIGHT_FRAME_LAST};
    for (int i = 0; i < n_payload; i++) frame.payload_size += payload[i].iov_len;
    if (c->server.max_payload && frame.payload_size > c->server.max_payload)
        return relight_fail(error, RELIGHT_E_LIMIT, "send less at once",
                            "%s request carries %llu bytes, the server takes %llu",
                            relight_type_name(type), (unsigned long long)frame.payload_size,
                            (unsigned long long)c->server.max_payload);
    if (deadline_s > 0) // 0 would mean none
        frame.deadline_ms = (uint32_t)(deadline_s < 4e6 ? fmax(1, deadline_s * 1e3) : 0);
    uint8_t *head;
    size_t head_size;
    struct iovec *piece = malloc(sizeof *piece * (size_t)(n_payload + 1));
    if (!piece || relight_frame_pack(&frame, message, 0, 0, &head, &head_size)) {
        free(piece);
        return relight_fail(error, RELIGHT_E_NO_MEMORY, "", "not enough memory for a request");
    }
    piece[0] = (struct iovec){head, head_size};
    for (int i = 0; i < n_payload; i++) piece[i + 1] = payload[i];
    struct out_item item = {.piece = piece, .n_piece = n_payload + 1};
    double end = deadline_s > 0 ? relight_now_s() + deadline_s + grace_s : INFINITY;
    int status = 0;
    bool one_way =
        relight_type_message(type | RELIGHT_TYPE_ANSWER) == &relight__nothing__descriptor;

    pthread_mutex_lock(&c->lock);
    if (c->reconnect_s > 0 && (status = revive(c, error))) goto done;
    struct slot *slot = c->broken || one_way ? NULL : add_slot(c, end, forget);
    if (c->broken || (!slot && !one_way)) {
        status = c->broken ? broken(c, error)
                           : relight_fail(error, RELIGHT_E_NO_MEMORY, "", "not enough memory");
        goto done;
    }
    if (slot) frame.id = slot->id;
    relight_frame_put_fixed(&frame, head);
    *c->out_tail = &item;
    c->out_tail = &item.next;
    if (c->out_head == &item) write_some(c);
    if (!item.done && c->leading && !c->lead_writes) wake_leader(c);
    while (!item.done && turn(c, end)) continue;
    if (!item.done) // half a request is on the wire: nothing can follow it
        break_connection(c, RELIGHT_E_TIMEOUT, "a request could not be sent in time");
    if (c->broken) {
        // An answer that came before the break is still to be had; a forgotten one is gone.
        slot = *find_slot(c, frame.id);
        if (one_way || (slot && !slot->last)) {
            status = broken(c, error);
            drop_slot(c, frame.id);
        }
    }
    if (id) *id = frame.id;
done:
    pthread_mutex_unlock(&c->lock);
    free(head);
    free(piece);
    return status;
}

int relight_cancel(struct relight_client *client, uint64_t id, struct relight_error *error)
{
    Relight__CancelRequest message = RELIGHT__CANCEL_REQUEST__INIT;
    message.id = id;
    return relight_start(client, RELIGHT_TYPE_CANCEL, &message.base, NULL, 0, 5, true, NULL,
                         error);
}

// The caller no longer waits: sends CANCEL and drops later answers.
void relight_forget(struct relight_client *c, uint64_t id)
{
    pthread_mutex_lock(&c->lock);
    struct slot *slot = *find_slot(c, id);
    bool alive = slot && !slot->last && !c->broken;
    if (alive) slot->forgotten = true;
    else drop_slot(c, id);
    for (struct answer *a = alive ? slot->head : NULL, *next; a; a = next) {
        next = a->next;
        relight_answer_free(a);
    }
    if (alive) {
        slot->head = NULL;
        slot->tail = &slot->head;
    }
    pthread_mutex_unlock(&c->lock);
    if (alive) relight_cancel(c, id, NULL);
}

int relight_next(struct relight_client *c, uint64_t id, double wait_s, struct answer **out,
                 struct relight_error *error)
{
    pthread_mutex_lock(&c->lock);
    struct slot *slot = *find_slot(c, id);
    if (!slot) {
        pthread_mutex_unlock(&c->lock);
        return relight_fail(error, RELIGHT_E_ARGUMENT, "", "no request %llu is outstanding",
                            (unsigned long long)id);
    }
    double end = wait_s >= 0 ? relight_now_s() + wait_s : slot->deadline_s;
    while (!slot->head && !slot->lost && turn(c, end)) continue;
    struct answer *answer = slot->head;
    if (!answer) {
        bool lost = slot->lost;
        int status = lost ? broken(c, error) : 0;
        if (lost) drop_slot(c, id);
        pthread_mutex_unlock(&c->lock);
        if (lost) return status;
        if (wait_s < 0) relight_forget(c, id);
        return relight_fail(error, RELIGHT_E_TIMEOUT, "allow more time (--timeout)",
                            "%s: no answer in time", c->address);
    }
    if (!(slot->head = answer->next)) slot->tail = &slot->head;
    if (answer->last) drop_slot(c, id);
    pthread_mutex_unlock(&c->lock);
    answer->next = NULL;
    if (answer->type == RELIGHT_TYPE_ERROR) {
        int status = relight_fail_message(error, (Relight__Error *)answer->message);
        relight_answer_free(answer);
        return status;
    }
    *out = answer;
    return 0;
}

bool relight_pending(struct relight_client *c, uint64_t id)
{
    pthread_mutex_lock(&c->lock);
    struct slot *slot = *find_slot(c, id);
    bool pending = slot && slot->head;
    pthread_mutex_unlock(&c->lock);
    return pending;
}

int relight_call(struct relight_client *client, uint16_t type, const ProtobufCMessage *message,
                 struct answer **out, struct relight_error *error)
{
    uint64_t id;
    int status =
        relight_start(client, type, message, NULL, 0, client->timeout_s, false, &id, error);
    if (status) return status;
    return relight_end(client, id, type, out, error);
}

int relight_end(struct relight_client *client, uint64_t id, uint16_t type, struct answer **out,
                struct relight_error *error)
{
    struct answer *answer;
    int status = relight_next(client, id, -1, &answer, error);
    if (status) return status;
    if (answer->type == (type | RELIGHT_TYPE_ANSWER) && answer->last) {
        *out = answer;
        return 0;
    }
    bool last = answer->last;
    relight_answer_free(answer);
    if (!last) relight_forget(client, id);
    return relight_fail(error, RELIGHT_E_PROTOCOL, "", "%s: unexpected answer to %s",
                        client->address, relight_type_name(type));
}

static int hello(struct relight_client *c, struct relight_error *error)
{
    struct answer *answer;
    Relight__HelloRequest m = RELIGHT__HELLO_REQUEST__INIT;
    m.client = relight_text(c->name);
    m.version_min = m.version_max = RELIGHT_PROTOCOL_VERSION;
    m.token = relight_text(c->token);
    m.max_payload = c->decoder.limits.max_payload;
    m.route = relight_text(c->route);
    m.stay = c->stay;
    uint64_t id;
    int status = relight_start(c, RELIGHT_TYPE_HELLO, &m.base, NULL, 0, c->connect_timeout_s,
                               false, &id, error);
    if (!status) status = relight_end(c, id, RELIGHT_TYPE_HELLO, &answer, error);
    if (status) return status;
    bool first = !c->hello;
    answer->next = c->hello;
    c->hello = answer;
    const Relight__HelloAnswer *a = (Relight__HelloAnswer *)c->hello->message;
    if (a->version != RELIGHT_PROTOCOL_VERSION)
        return relight_fail(error, RELIGHT_E_VERSION, "install matching versions",
                            "%s speaks protocol version %u, this client %d", c->address,
                            a->version, RELIGHT_PROTOCOL_VERSION);
    if (!first) return 0; // other threads may be reading it
    c->server = (struct relight_server){.name = a->server,
                                        .run = a->run,
                                        .address = c->address,
                                        .max_payload = a->max_payload,
                                        .max_blob = a->max_blob,
                                        .max_in_flight = a->max_in_flight,
                                        .chunk = a->chunk,
                                        .n_preset = a->n_presets,
                                        .preset = (const char *const *)a->presets,
                                        .principal = a->principal,
                                        .n_scope = a->n_scopes,
                                        .scope = (const char *const *)a->scopes,
                                        .expires_s = a->expires_s};
    return 0;
}

int relight_connect(const char *address, const struct relight_options *options,
                    struct relight_client **out, struct relight_error *error)
{
    char name[512];
    struct relight_options o = options ? *options : (struct relight_options){0};
    if (!(o.connect_timeout_s > 0)) o.connect_timeout_s = 5;
    if (!address || !*address) address = relight_default_address(name, sizeof name);
    struct relight_tls *tls = NULL;
    const char *named = getenv("RELIGHT_CA");
    if (!o.ca && named && *named) o.ca = named;
    int fd = open_transport(address, o.ca, o.connect_timeout_s, &tls, error);
    if (fd < 0) return fd;
    struct relight_client *c = calloc(1, sizeof *c);
    if (!c) {
        relight_tls_close(tls);
        close(fd);
        return relight_fail(error, RELIGHT_E_NO_MEMORY, "", "not enough memory");
    }
    pthread_mutex_init(&c->lock, NULL);
    pthread_condattr_t attr;
    pthread_condattr_init(&attr);
    pthread_condattr_setclock(&attr, CLOCK_MONOTONIC);
    pthread_cond_init(&c->changed, &attr);
    pthread_condattr_destroy(&attr);
    c->fd = fd;
    c->tls = tls;
    c->wake_fd = eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK);
    c->next_id = 1;
    c->out_tail = &c->out_head;
    c->timeout_s = o.timeout_s > 0 ? o.timeout_s : 0;
    c->connect_timeout_s = o.connect_timeout_s;
    c->address = strdup(address);
    c->name = strdup(o.name ? o.name : "librelight");
    c->token = strdup(o.token ? o.token : "");
    c->ca = o.ca ? strdup(o.ca) : NULL;
    c->route = strdup(o.route ? o.route : "");
    c->read_buffer = malloc(READ_SIZE);
    struct relight_frame_limits limits = {16u << 20,
                                          o.max_payload ? o.max_payload : UINT64_C(4) << 30};
    relight_decoder_init(&c->decoder, &limits);
    bool whole =
        c->address && c->name && c->token && c->route && (!o.ca || c->ca) && c->read_buffer;
    int status = whole && c->wake_fd >= 0
                     ? hello(c, error)
                     : relight_fail(error, RELIGHT_E_NO_MEMORY, "", "not enough memory");
    if (status == -RELIGHT_E_MOVED) {
        pthread_mutex_lock(&c->lock);
        c->reviving = true;
        c->reviver = pthread_self();
        status = connect_routed(c, c->address, error);
        c->reviving = false;
        pthread_mutex_unlock(&c->lock);
    }
    // A peer that closes, or does not answer HELLO, counts as unreachable.
    if (status == -RELIGHT_E_DISCONNECTED || status == -RELIGHT_E_TIMEOUT ||
        status == -RELIGHT_E_PROTOCOL) {
        if (error) error->code = RELIGHT_E_UNREACHABLE;
        if (error && !strncmp(address, "tcp:", 4))
            snprintf(error->hint, sizeof error->hint,
                     "is this the daemon's address? If it speaks TLS: -s tls:%.200s",
                     address + 4);
        status = -RELIGHT_E_UNREACHABLE;
    }
    if (status) {
        relight_close(c);
        return status;
    }
    c->reconnect_s = o.reconnect_s > 0 ? o.reconnect_s : 0;
    *out = c;
    return 0;
}

void relight_close(struct relight_client *c)
{
    if (!c) return;
    relight_tls_close(c->tls);
    close(c->fd);
    if (c->wake_fd >= 0) close(c->wake_fd);
    for (int i = 0; i < N_BUCKET; i++) {
        for (struct slot *s = c->bucket[i], *next; s; s = next) {
            next = s->next;
            free_slot(s);
        }
    }
    relight_decoder_finish(&c->decoder);
    for (struct answer *a = c->hello, *next; a; a = next) {
        next = a->next;
        relight_answer_free(a);
    }
    pthread_cond_destroy(&c->changed);
    pthread_mutex_destroy(&c->lock);
    free(c->read_buffer);
    free(c->address);
    free(c->name);
    free(c->token);
    free(c->route);
    free(c->ca);
    free(c);
}

const struct relight_server *relight_server(const struct relight_client *client)
{
    return &client->server;
}
