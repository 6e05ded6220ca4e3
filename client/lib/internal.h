/* SPDX-License-Identifier: MIT */
/* Shared by the files of librelight: the connection's engine, and building and reading
 * messages. */
#ifndef RELIGHT_INTERNAL_H
#define RELIGHT_INTERNAL_H

#include "frame.h"
#include "relight.pb-c.h"
#include "relight/relight.h"

#include <pthread.h>
#include <stdlib.h>
#include <string.h>
#include <sys/uio.h>

/* ---- errors ---- */
/* Fills *error (may be NULL) and returns -code. */
int relight_fail(struct relight_error *error, int code, const char *hint, const char *fmt, ...)
    __attribute__((format(printf, 4, 5)));
int relight_fail_message(struct relight_error *error, const Relight__Error *message);

/* ---- address.c ---- */
/* Connected non-blocking socket, or -code. host: that of tls:HOST:PORT, else "". */
int relight_socket(const char *address, double timeout_s, char host[256],
                   struct relight_error *error);
/* The default address into buf. */
const char *relight_default_address(char *buf, size_t n);
double relight_now_s(void);

/* ---- connection.c ---- */
struct answer {
    struct answer *next;
    uint16_t type;
    bool last;
    ProtobufCMessage *message; /* never NULL */
    uint8_t *payload;          /* free() */
    uint64_t payload_size;
};
void relight_answer_free(struct answer *answer);

/* Sends a request and waits until all of it is written. payload may be NULL. deadline_s: given
 * to the daemon, 0 none. *id is set. With `forget` nobody will wait for its answers. */
int relight_start(struct relight_client *client, uint16_t type, const ProtobufCMessage *message,
                  const struct iovec *payload, int n_payload, double deadline_s, bool forget,
                  uint64_t *id, struct relight_error *error);
/* Next answer of a request; RELIGHT_E_TIMEOUT when none came in wait_s (< 0: its own deadline
 * and a grace, after which it is cancelled and forgotten). An ERROR frame becomes the return
 * value. After an answer with LAST, or an error that is not a bare timeout, the id is gone. */
int relight_next(struct relight_client *client, uint64_t id, double wait_s, struct answer **out,
                 struct relight_error *error);
/* Whether an answer already waits. */
bool relight_pending(struct relight_client *client, uint64_t id);
/* start, then next; checks the answer's type. */
int relight_call(struct relight_client *client, uint16_t type, const ProtobufCMessage *message,
                 struct answer **out, struct relight_error *error);
/* The second half of relight_call: the one answer of a started request. */
int relight_end(struct relight_client *client, uint64_t id, uint16_t type, struct answer **out,
                struct relight_error *error);
/* Cancels a request and drops what still comes for it; the id is gone. */
void relight_forget(struct relight_client *client, uint64_t id);
double relight_timeout(const struct relight_client *client);
/* Whether the client connects again after its connection was lost. */
bool relight_reconnects(const struct relight_client *client);

/* ---- upload.c ---- */
struct relight_content {
    char *bytes; /* free() */
    size_t size;
};
/* A regular file that is not empty, of at most so many bytes; 0: of any size. It is read, not
 * mapped: a map of a file that becomes shorter ends the process. */
int relight_read_file(const char *path, uint64_t most, struct relight_content *out,
                      struct relight_error *error);
const char *relight_base_name(const char *path);

/* ---- messages.c: plain structs to messages and back ---- */
/* Memory that an output owns: the answer, and arrays made from it. */
struct owner {
    struct answer *answer;
    void *extra[4];
    unsigned n_extra;
};
struct owner *relight_owner(struct answer *answer); /* takes the answer; frees it on failure */
void *relight_owner_alloc(struct owner *owner, size_t n, size_t size); /* zeroed */
void relight_owner_free(struct owner *owner);

/* A request's light, shading and picture as messages, in one place on the stack. */
enum { RELIGHT_MAX_LIGHT = 16 };
struct request_parts {
    Relight__Light light[RELIGHT_MAX_LIGHT], *lights[RELIGHT_MAX_LIGHT];
    Relight__Vec3 gain[RELIGHT_MAX_LIGHT];
    struct iovec cube[RELIGHT_MAX_LIGHT];
    int n_cube;
    Relight__Shade shade;
    Relight__Vec3 shade_eye;
    Relight__ObjectMaterial material[RELIGHT_MAX_MATERIAL], *materials[RELIGHT_MAX_MATERIAL];
    Relight__Picture picture;
    Relight__Camera camera;
    Relight__Orbit orbit;
    Relight__Vec3 eye, target, up, background;
};
int relight_put_lights(struct request_parts *parts, size_t n,
                       const struct relight_light *lights, struct relight_error *error);
/* Rotation and gain alone, for lights that a view has. */
int relight_put_turns(struct request_parts *parts, size_t n, const struct relight_light *lights,
                      struct relight_error *error);
int relight_put_materials(size_t n, const struct relight_object_material *in,
                          Relight__ObjectMaterial message[RELIGHT_MAX_MATERIAL],
                          Relight__ObjectMaterial *list[RELIGHT_MAX_MATERIAL],
                          struct relight_error *error);
int relight_put_shade(struct request_parts *parts, const struct relight_shade *shade,
                      struct relight_error *error);
void relight_put_picture(struct request_parts *parts, const struct relight_picture *picture);
void relight_get_cost(const Relight__Cost *message, struct relight_cost *out);
/* Of one colour of an enum relight_color_format; 0: of no fixed size. */
unsigned relight_color_bytes(unsigned format);
/* Check the description against the payload and point into it. */
int relight_get_colors(const Relight__ColorsAnswer *message, const uint8_t *payload,
                       uint64_t payload_size, struct relight_colors *out,
                       struct relight_error *error);
/* The coefficients of an answer, checked; they point into it. */
bool relight_get_coefficients(const Relight__ColorsAnswer *message, struct relight_colors *out);
/* Whether the format holds coefficients in place of colours. */
static inline bool relight_is_coefficients(int format)
{
    return format == RELIGHT_COLOR_COEFFICIENTS || format == RELIGHT_COLOR_COEFFICIENTS_PACKED;
}
/* The factors of an answer that was fetched with most_rank, checked; they point into it. */
int relight_get_factors(const Relight__FactorsAnswer *message, const struct answer *answer,
                        uint32_t most_rank, struct relight_factors *out,
                        struct relight_error *error);
/* The coarse order of an answer, checked; it points into it. */
int relight_get_coarse_order(const Relight__GeometryAnswer *message,
                             const struct answer *answer, struct relight_coarse_order *out,
                             struct relight_error *error);
int relight_get_image(const Relight__ImageAnswer *message, const uint8_t *payload,
                      uint64_t payload_size, struct relight_image *out,
                      struct relight_error *error);
int relight_get_blocks(struct owner *owner, size_t n, Relight__Block **blocks,
                       const struct relight_block **out);
/* Textures of an answer to GEOMETRY: whether its sections lie in the payload; the fields of
 * *out. false without memory. */
bool relight_textures_fit(const Relight__GeometryAnswer *a, const struct answer *answer);
bool relight_get_textures(struct owner *owner, const struct answer *answer,
                          struct relight_geometry *out);
static inline char *relight_text(const char *text)
{
    static char empty[1];
    return text ? (char *)(uintptr_t)text : empty;
}

#endif
