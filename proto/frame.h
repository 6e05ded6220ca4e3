/* SPDX-License-Identifier: MIT */
/* proto/frame.h owns the frames that carry every message (PROTOCOL.md): encoding, an
 * incremental decoder for byte streams, and a parser for carriers that keep messages whole
 * (WebSocket). It knows nothing of sockets. Links protobuf-c only. */
#ifndef RELIGHT_FRAME_H
#define RELIGHT_FRAME_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include <protobuf-c/protobuf-c.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Fixed part, 32 bytes, little-endian:
 *    0 u32 magic 0x54474c52 ("RLGT")     4 u8 version   5 u8 flags   6 u16 type
 *    8 u64 request id                   16 u32 header length         20 u32 deadline [ms]
 *   24 u64 payload length
 * then the header (protobuf), zeros up to the next multiple of 64 counted from the frame's
 * first byte when a payload follows (none otherwise), then the payload. */
enum {
    RELIGHT_FRAME_FIXED = 32,
    RELIGHT_FRAME_ALIGN = 64,
    RELIGHT_PROTOCOL_VERSION = 1,
    RELIGHT_DEFAULT_PORT = 7413
};
#define RELIGHT_FRAME_MAGIC UINT32_C(0x54474c52)

enum relight_frame_flag {
    RELIGHT_FRAME_MORE = 1, /* this message's payload goes on in the next frame with this id */
    RELIGHT_FRAME_LAST = 2, /* no further message has this id in this direction */
    /* Bits 2 and 3 are for later flags that change how a frame is read: one that is set is a
     * fault. Bits 4 to 7 are for hints: receivers ignore those that they do not know. */
    RELIGHT_FRAME_IGNORABLE = 0xf0,
};

/* name, number, request message, answer message; nothing: one-way, without an answer */
#define RELIGHT_TYPE_LIST(X)                                                \
    X(HELLO, 1, hello_request, hello_answer)                                \
    X(PING, 2, ping_request, ping_answer)                                   \
    X(LIST, 3, list_request, list_answer)                                   \
    X(PUT_BLOB, 4, put_blob_request, put_blob_answer)                       \
    X(ENV, 5, env_request, env_answer)                                      \
    X(LOAD, 6, load_request, load_answer)                                   \
    X(WATCH, 7, watch_request, progress)                                    \
    X(CANCEL_JOB, 8, cancel_job_request, cancel_job_answer)                 \
    X(CANCEL, 9, cancel_request, cancel_answer)                             \
    X(INFO, 10, info_request, model_info)                                   \
    X(GEOMETRY, 11, geometry_request, geometry_answer)                      \
    X(COLORS, 12, colors_request, colors_answer)                            \
    X(IMAGE, 13, image_request, image_answer)                               \
    X(VIEW_OPEN, 14, view_open_request, view_frame)                         \
    X(VIEW_SET, 15, view_set_request, view_set_answer)                      \
    X(VIEW_CLOSE, 16, view_close_request, view_close_answer)                \
    X(UPDATE_VERTICES, 17, update_vertices_request, update_vertices_answer) \
    X(UNLOAD, 18, unload_request, unload_answer)                            \
    X(STATS, 19, stats_request, stats_answer)                               \
    X(SUBSCRIBE, 20, subscribe_request, event)                              \
    X(TOKEN_CREATE, 21, token_create_request, token_create_answer)          \
    X(TOKEN_LIST, 22, token_list_request, token_list_answer)                \
    X(TOKEN_REVOKE, 23, token_revoke_request, token_revoke_answer)          \
    X(VIEW_ACK, 24, view_ack, nothing)                                      \
    X(GET_BLOB, 25, get_blob_request, get_blob_answer)                      \
    X(PUT_POSE, 26, put_pose_request, put_pose_answer)                      \
    X(FACTORS, 27, factors_request, factors_answer)                         \
    X(ROOM_CREATE, 28, room_create_request, room_create_answer)             \
    X(ROOM_LIST, 29, room_list_request, room_list_answer)                   \
    X(ROOM_GET, 30, room_get_request, room_get_answer)                      \
    X(ROOM_EDIT, 31, room_edit_request, room_edit_answer)                   \
    X(ROOM_PICTURE, 32, room_picture_request, image_answer)                 \
    X(ROOM_PRESENCE, 33, room_presence_request, nothing)                    \
    X(ROOM_BACKUP, 34, room_backup_request, room_backup_answer)             \
    X(SIGN, 35, sign_request, sign_answer)                                  \
    X(MATERIAL, 36, material_request, material_answer)

/* As large as the largest number and one: tables by request type have this many rows. */
union relight_type_room {
#define X(name, number, request, answer) char name[(number) + 1];
    RELIGHT_TYPE_LIST(X)
#undef X
};
enum { RELIGHT_TYPE_N = sizeof(union relight_type_room) };

enum relight_type {
#define X(name, number, request, answer) RELIGHT_TYPE_##name = (number),
    RELIGHT_TYPE_LIST(X)
#undef X
        RELIGHT_TYPE_ANSWER = 0x8000, /* an answer has the request's type with this bit */
    RELIGHT_TYPE_GOAWAY = 0xfffe,     /* unasked, id 0 */
    RELIGHT_TYPE_ERROR = 0xffff
};
/* "hello", "put_blob", … for a request's or answer's type; "error"; "unknown". */
const char *relight_type_name(uint16_t type);
/* Message of a type (answers included), NULL for unknown ones. */
const ProtobufCMessageDescriptor *relight_type_message(uint16_t type);

struct relight_frame {
    uint8_t flags; /* enum relight_frame_flag; ignorable ones are dropped in parsing */
    uint16_t type;
    uint64_t id;
    uint32_t deadline_ms; /* requests: from their arrival; 0: none. Answers: 0 */
    uint32_t header_size;
    uint64_t payload_size;
    const uint8_t *header; /* [header_size] */
    uint8_t *payload;      /* [payload_size], 64-byte aligned from relight_decoder */
};

/* Limits on one frame. Frames beyond them are refused before anything is allocated. */
struct relight_frame_limits {
    uint32_t max_header;  /* bytes */
    uint64_t max_payload; /* bytes */
    bool whole;           /* refuse frames with MORE: what a daemon does, requests are whole */
};

/* Bytes before the payload: fixed part, header, padding. */
size_t relight_frame_prefix_size(uint32_t header_size, uint64_t payload_size);
/* Writes the fixed part. */
void relight_frame_put_fixed(const struct relight_frame *frame,
                             uint8_t out[RELIGHT_FRAME_FIXED]);

/* Packs everything before the payload into one malloc()ed buffer with `lead` unused bytes in
 * front of it and `room` after it (for LWS_PRE and short payloads): (*out)[lead .. lead +
 * *size). message may be NULL (continuation frames). `frame` gives flags, type, id, deadline_ms
 * and payload_size; its header_size is set. Returns 0, or -1 without memory. */
int relight_frame_pack(struct relight_frame *frame, const ProtobufCMessage *message,
                       size_t lead, size_t room, uint8_t **out, size_t *size);

/* Faults of a frame's bytes. */
#define RELIGHT_FRAME_FAULT_LIST(X)                                          \
    X(MAGIC, -1, "does not start with RLGT: not this protocol")              \
    X(VERSION, -2, "frame version is not 1")                                 \
    X(FLAGS, -3, "flags are set that are unknown or not for this direction") \
    X(HEADER, -4, "header is longer than the limit")                         \
    X(PAYLOAD, -5, "payload is longer than the limit")                       \
    X(PADDING, -6, "padding before the payload is not zero")                 \
    X(SHORT, -7, "message ends before its frame does")                       \
    X(LONG, -8, "message goes on after its frame")                           \
    X(MEMORY, -9, "not enough memory for the frame")
enum relight_frame_fault {
#define X(name, code, text) RELIGHT_FAULT_##name = (code),
    RELIGHT_FRAME_FAULT_LIST(X)
#undef X
};
const char *relight_frame_fault_text(int fault);

/* Parses exactly one frame that fills `bytes` (a WebSocket message). out->header and
 * out->payload point into bytes. Returns 0 or a fault. Does not allocate. */
int relight_frame_parse(const void *bytes, size_t n, const struct relight_frame_limits *limits,
                        struct relight_frame *out);

/* Incremental decoder of a byte stream. One thread at a time. After a fault it stays faulty:
 * the stream has lost its frames and must be closed. */
struct relight_decoder {
    struct relight_frame_limits limits;
    struct relight_frame frame; /* valid when `ready` */
    int fault;
    bool ready, refused; /* refused: `admit` did not take this frame's payload */
    /* Asked before a payload is allocated; NULL: every one is taken. False: its bytes are read
     * and dropped, and the frame comes without them. */
    bool (*admit)(void *user, const struct relight_frame *frame);
    void *admit_user;
    uint8_t fixed[RELIGHT_FRAME_FIXED];
    uint8_t *head; /* header and padding of the current frame */
    size_t head_size, head_room;
    uint64_t have; /* bytes of the current frame so far */
};
void relight_decoder_init(struct relight_decoder *decoder,
                          const struct relight_frame_limits *limits);
void relight_decoder_finish(struct relight_decoder *decoder);

/* Takes bytes up to the end of the current frame; *used says how many. Returns 1 when a frame
 * is ready in decoder->frame (it stays until the next feed or commit; see
 * relight_decoder_take), 0 when more bytes are needed, or a fault. Call again with the rest
 * after 1. */
int relight_decoder_feed(struct relight_decoder *decoder, const void *bytes, size_t n,
                         size_t *used);
/* Without a copy: where the next bytes belong (up to *n of them, never beyond this frame), and
 * what was put there. The same returns as feed for commit; NULL from space after a fault or
 * while a frame is ready (commit 0 bytes to go on). */
uint8_t *relight_decoder_space(struct relight_decoder *decoder, size_t *n);
int relight_decoder_commit(struct relight_decoder *decoder, size_t n);
/* Hands the ready frame's payload to the caller, who frees it with free(). NULL without
 * payload. */
uint8_t *relight_decoder_take(struct relight_decoder *decoder);

/* Unpacks a frame's header as the message of its type; NULL when it does not parse or its type
 * is unknown. Free with protobuf_c_message_free_unpacked(message, NULL). */
ProtobufCMessage *relight_frame_unpack(const struct relight_frame *frame);

/* What a header takes once it is unpacked: its messages, strings and unknown fields, and about
 * how many bytes. */
struct relight_header_cost {
    uint32_t items;
    size_t bytes;
};
struct relight_header_limits {
    uint32_t max_items;
    size_t max_bytes;
};
enum { RELIGHT_HEADER_ERROR = 160 };
/* Walks a header on the wire, without allocating: true when it is a message of this type within
 * the limits (NULL: none), every string is valid UTF-8 without zero bytes, and names hold no
 * control characters. Else false, and error names the field. *cost is filled as far as it was
 * walked. A header that passes may still fail to unpack. */
bool relight_header_check(uint16_t type, const uint8_t *bytes, size_t n,
                          const struct relight_header_limits *limits,
                          struct relight_header_cost *cost, char error[RELIGHT_HEADER_ERROR]);
/* Replaces what is not UTF-8 in a packed header's strings by question marks, in place:
 * receivers refuse a whole message for one such byte. */
void relight_header_repair(uint16_t type, uint8_t *bytes, size_t n);

/* Bytes of the UTF-8 character that begins here, 0 where there is none. */
size_t relight_utf8_next(const uint8_t *bytes, size_t n);
/* Takes away the beginning of a character that a limit cut off at the end of the text. */
void relight_utf8_cut(char *text);

/* SHA-256, the content address of blobs. */
struct relight_sha256 {
    uint32_t state[8];
    uint64_t size;
    uint8_t block[64];
};
void relight_sha256_init(struct relight_sha256 *sha);
void relight_sha256_add(struct relight_sha256 *sha, const void *bytes, size_t n);
void relight_sha256_hex(struct relight_sha256 *sha, char out[65]); /* ends it */
/* 64 lower-case hex digits and nothing else. */
bool relight_hash_valid(const char *text);

#ifdef __cplusplus
}
#endif
#endif
