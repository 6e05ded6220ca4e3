// SPDX-License-Identifier: MIT
// Frames: the vectors byte for byte both ways, every cut of the stream, hostile lengths,
// SHA-256. `test_proto --write DIR` writes the vectors.
#include "proto_vectors.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

static struct vector vectors[MAX_VECTOR];
static unsigned n_vector;
static const struct relight_frame_limits limits = {1 << 16, 1 << 20};

static uint8_t *pack(const struct vector *v, size_t *size)
{
    struct relight_frame frame = v->frame;
    uint8_t *bytes;
    assert_int_equal(
        relight_frame_pack(&frame, v->message, 0, v->frame.payload_size, &bytes, size), 0);
    if (v->frame.payload_size) memcpy(bytes + *size, v->payload, v->frame.payload_size);
    *size += v->frame.payload_size;
    return bytes;
}

static uint8_t *read_vector(const char *name, size_t *size)
{
    char path[512];
    snprintf(path, sizeof path, "%s/%s.bin", PROTO_VECTORS, name);
    FILE *f = fopen(path, "rb");
    if (!f) fail_msg("%s is missing: test_proto --write proto/vectors makes it", path);
    uint8_t *bytes = malloc(1 << 20);
    *size = fread(bytes, 1, 1 << 20, f);
    fclose(f);
    return bytes;
}

static void encode_exact(void **state)
{
    for (unsigned i = 0; i < n_vector; i++) {
        size_t n, m;
        uint8_t *made = pack(vectors + i, &n), *stored = read_vector(vectors[i].name, &m);
        if (n != m || memcmp(made, stored, n)) fail_msg("%s.bin differs", vectors[i].name);
        free(made);
        free(stored);
    }
}

// Decoded and packed again: the same bytes; type, id and payload as they were put in.
static void decode_exact(void **state)
{
    for (unsigned i = 0; i < n_vector; i++) {
        const struct vector *v = vectors + i;
        struct relight_frame frame;
        size_t n, m;
        uint8_t *stored = read_vector(v->name, &n), *again;
        assert_int_equal(relight_frame_parse(stored, n, &limits, &frame), 0);
        assert_int_equal(frame.type, v->frame.type);
        assert_int_equal(frame.flags, v->frame.flags);
        assert_int_equal(frame.id, v->frame.id);
        assert_int_equal(frame.deadline_ms, v->frame.deadline_ms);
        assert_int_equal(frame.payload_size, v->frame.payload_size);
        if (frame.payload_size) {
            assert_int_equal((frame.payload - stored) % RELIGHT_FRAME_ALIGN, 0);
            assert_memory_equal(frame.payload, v->payload, frame.payload_size);
        }
        ProtobufCMessage *message = v->message ? relight_frame_unpack(&frame) : NULL;
        assert_true(!v->message || message);
        assert_int_equal(relight_frame_pack(&frame, message, 0, frame.payload_size, &again, &m),
                         0);
        if (frame.payload_size) memcpy(again + m, frame.payload, frame.payload_size);
        m += frame.payload_size;
        assert_int_equal(n, m);
        assert_memory_equal(stored, again, n);
        if (message) protobuf_c_message_free_unpacked(message, NULL);
        free(again);
        free(stored);
    }
}

// All vectors as one stream.
static uint8_t *stream(size_t *size)
{
    uint8_t *all = malloc(1 << 20);
    *size = 0;
    for (unsigned i = 0; i < n_vector; i++) {
        size_t n;
        uint8_t *one = pack(vectors + i, &n);
        memcpy(all + *size, one, n);
        *size += n;
        free(one);
    }
    return all;
}

// Any cut of the stream gives the same frames, through feed and through space/commit.
static void decode_in_pieces(void **state)
{
    static const size_t pieces[] = {1, 2, 3, 7, 31, 32, 33, 63, 64, 65, 1000, 1 << 20};
    size_t size;
    uint8_t *all = stream(&size);
    for (unsigned p = 0; p < 2 * sizeof pieces / sizeof *pieces; p++) {
        size_t piece = pieces[p / 2], at = 0;
        unsigned seen = 0;
        struct relight_decoder d;
        relight_decoder_init(&d, &limits);
        while (at < size) {
            size_t n = size - at < piece ? size - at : piece, used;
            int status;
            if (p % 2) {
                if (d.ready) relight_decoder_commit(&d, 0);
                size_t room;
                uint8_t *to = relight_decoder_space(&d, &room);
                assert_non_null(to);
                used = n < room ? n : room;
                memcpy(to, all + at, used);
                status = relight_decoder_commit(&d, used);
            } else {
                status = relight_decoder_feed(&d, all + at, n, &used);
            }
            assert_true(status >= 0);
            at += used;
            if (!status) continue;
            const struct vector *v = vectors + seen++;
            assert_int_equal(d.frame.id, v->frame.id);
            assert_int_equal(d.frame.type, v->frame.type);
            assert_int_equal(d.frame.payload_size, v->frame.payload_size);
            if (!v->frame.payload_size) continue;
            uint8_t *payload = relight_decoder_take(&d);
            assert_int_equal((uintptr_t)payload % RELIGHT_FRAME_ALIGN, 0);
            assert_memory_equal(payload, v->payload, v->frame.payload_size);
            free(payload);
        }
        assert_int_equal(seen, n_vector);
        relight_decoder_finish(&d);
    }
    free(all);
}

// Refuses the payloads of even numbers.
static bool admit_odd(void *user, const struct relight_frame *frame)
{
    unsigned *n = user;
    return ++*n % 2;
}

// A refused payload is read over; the one after it is whole.
static void refused_payloads(void **state)
{
    size_t size;
    uint8_t *all = stream(&size);
    for (size_t piece = 1; piece <= size; piece = 7 * piece) {
        unsigned seen = 0, n_payload = 0, asked = 0;
        struct relight_decoder d;
        relight_decoder_init(&d, &limits);
        d.admit = admit_odd;
        d.admit_user = &asked;
        for (size_t at = 0, used; at < size; at += used) {
            size_t n = size - at < piece ? size - at : piece;
            if (!relight_decoder_feed(&d, all + at, n, &used)) continue;
            const struct vector *v = vectors + seen++;
            assert_int_equal(d.frame.id, v->frame.id);
            if (!v->frame.payload_size) continue;
            uint8_t *payload = relight_decoder_take(&d);
            assert_int_equal(d.refused, ++n_payload % 2 == 0);
            if (d.refused) assert_null(payload);
            else assert_memory_equal(payload, v->payload, v->frame.payload_size);
            free(payload);
        }
        assert_int_equal(seen, n_vector);
        assert_true(n_payload > 2 && asked == n_payload);
        relight_decoder_finish(&d);
    }
    free(all);
}

static int decode_changed(size_t at, const void *bytes, size_t n)
{
    size_t size, used;
    uint8_t *all = pack(vectors + 2, &size); // ping with a payload
    memcpy(all + at, bytes, n);
    struct relight_decoder d;
    struct relight_frame frame;
    relight_decoder_init(&d, &limits);
    int status = relight_decoder_feed(&d, all, size, &used);
    int whole = relight_frame_parse(all, size, &limits, &frame);
    if (status < 0) {
        assert_int_equal(relight_decoder_feed(&d, all, size, &used), status); // it stays broken
        assert_null(relight_decoder_space(&d, &used));
        assert_int_equal(whole, status);
    }
    relight_decoder_finish(&d);
    free(all);
    return status;
}

static void refuses(void **state)
{
    assert_int_equal(decode_changed(0, "RLGX", 4), RELIGHT_FAULT_MAGIC);
    assert_int_equal(decode_changed(4, "\x02", 1), RELIGHT_FAULT_VERSION);
    assert_int_equal(decode_changed(5, "\x04", 1), RELIGHT_FAULT_FLAGS);
    assert_int_equal(decode_changed(5, "\x0a", 1), RELIGHT_FAULT_FLAGS);
    assert_int_equal(decode_changed(5, "\xf2", 1), 1); // hints that nobody knows yet
    assert_int_equal(decode_changed(16, "\x01\x00\x01\x00", 4), RELIGHT_FAULT_HEADER);
    assert_int_equal(decode_changed(16, "\xff\xff\xff\xff", 4), RELIGHT_FAULT_HEADER);
    assert_int_equal(decode_changed(24, "\x01\x00\x10\x00", 4), RELIGHT_FAULT_PAYLOAD);
    assert_int_equal(decode_changed(24, "\xff\xff\xff\xff\xff\xff\xff\xff", 8),
                     RELIGHT_FAULT_PAYLOAD);
    assert_int_equal(decode_changed(40, "\x01", 1), RELIGHT_FAULT_PADDING);
    assert_int_equal(decode_changed(6, "\x77\x77", 2), 1); // unknown types are not framing's
}

// A daemon takes no split requests; a client takes split answers.
static void split_requests_are_refused(void **state)
{
    struct relight_frame_limits whole = limits;
    struct relight_frame frame;
    whole.whole = true;
    for (unsigned i = 0; i < n_vector; i++) {
        size_t n;
        uint8_t *bytes = pack(vectors + i, &n);
        bool more = vectors[i].frame.flags & RELIGHT_FRAME_MORE;
        assert_int_equal(relight_frame_parse(bytes, n, &whole, &frame),
                         more ? RELIGHT_FAULT_FLAGS : 0);
        free(bytes);
    }
}

static void whole_message_lengths(void **state)
{
    size_t size;
    struct relight_frame frame;
    uint8_t *all = pack(vectors + 2, &size);
    uint8_t *longer = calloc(1, size + 1);
    memcpy(longer, all, size);
    for (size_t n = 0; n < size; n++)
        assert_int_equal(relight_frame_parse(all, n, &limits, &frame), RELIGHT_FAULT_SHORT);
    assert_int_equal(relight_frame_parse(longer, size + 1, &limits, &frame),
                     RELIGHT_FAULT_LONG);
    free(longer);
    free(all);
}

static void space_around_a_packed_frame(void **state)
{
    struct relight_frame frame = vectors[0].frame;
    uint8_t *bytes;
    size_t n;
    assert_int_equal(relight_frame_pack(&frame, vectors[0].message, 16, 5, &bytes, &n), 0);
    memset(bytes, 0xaa, 16);
    memset(bytes + 16 + n, 0xbb, 5);
    assert_memory_equal(bytes + 16, "RLGT", 4);
    assert_int_equal(n, relight_frame_prefix_size(frame.header_size, 0));
    free(bytes);
    assert_int_equal(relight_frame_pack(&frame, NULL, SIZE_MAX, 0, &bytes, &n), -1);
}

static void names(void **state)
{
    assert_string_equal(relight_type_name(12), "COLORS");
    assert_string_equal(relight_type_name(12 | RELIGHT_TYPE_ANSWER), "COLORS");
    assert_string_equal(relight_type_name(RELIGHT_TYPE_ERROR), "ERROR");
    assert_string_equal(relight_type_name(RELIGHT_TYPE_GOAWAY), "GOAWAY");
    assert_string_equal(relight_type_name(0), "unknown");
    assert_string_equal(relight_type_name(RELIGHT_TYPE_N), "unknown");
    for (uint16_t type = 1; type < RELIGHT_TYPE_N; type++) { // a message has a name of its own
        const char *name = relight_type_name(type);
        assert_int_equal(relight_type_message(type) != NULL, strcmp(name, "unknown") != 0);
        for (uint16_t other = 1; other < type; other++)
            if (relight_type_message(type))
                assert_string_not_equal(relight_type_name(other), name);
    }
    assert_null(relight_type_message(0));
    assert_null(relight_type_message(RELIGHT_TYPE_N));
    assert_ptr_equal(relight_type_message(0xffff), &relight__error__descriptor);
}

static void hex(const void *bytes, size_t n, size_t piece, char out[65])
{
    struct relight_sha256 sha;
    relight_sha256_init(&sha);
    for (size_t at = 0; at < n; at += piece)
        relight_sha256_add(&sha, (const char *)bytes + at, n - at < piece ? n - at : piece);
    relight_sha256_hex(&sha, out);
}

// FIPS 180-4's examples, and a million letters in uneven pieces.
static void sha256(void **state)
{
    char out[65];
    hex("", 0, 1, out);
    assert_string_equal(out,
                        "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855");
    hex("abc", 3, 1, out);
    assert_string_equal(out,
                        "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
    hex("abcdbcdecdefdefgefghfghighijhijkijkljklmklmnlmnomnopnopq", 56, 56, out);
    assert_string_equal(out,
                        "248d6a61d20638b8e5c026930c3e6039a33ce45964ff2167f6ecedd419db06c1");
    char *a = malloc(1000000);
    memset(a, 'a', 1000000);
    for (size_t piece = 61; piece < 1000; piece += 101) {
        hex(a, 1000000, piece, out);
        assert_string_equal(out,
                            "cdc76e5c9914fb9281a1c7e284d73e67f1809a48a497200e046d39ccc7112cd0");
    }
    free(a);
    assert_true(relight_hash_valid(out));
    out[3] = 'A';
    assert_false(relight_hash_valid(out));
}

// The vector's blob has the hash that its request promises.
static void vector_hash(void **state)
{
    char out[65];
    const Relight__PutBlobRequest *m = (const Relight__PutBlobRequest *)vectors[5].message;
    hex(vectors[5].payload, 100, 100, out);
    assert_string_equal(out, m->hash);
}

static int write_vectors(const char *folder)
{
    char path[512];
    snprintf(path, sizeof path, "%s/session.txt", folder);
    FILE *list = fopen(path, "w");
    if (!list) return 1;
    fputs("file                id  type    flags  bytes  what (C: client, S: server)\n", list);
    for (unsigned i = 0; i < n_vector; i++) {
        const struct relight_frame *f = &vectors[i].frame;
        size_t n;
        uint8_t *bytes = pack(vectors + i, &n);
        snprintf(path, sizeof path, "%s/%s.bin", folder, vectors[i].name);
        FILE *file = fopen(path, "wb");
        if (!file || fwrite(bytes, 1, n, file) != n || fclose(file)) return 1;
        free(bytes);
        fprintf(list, "%-18s %3d  0x%04x  %-5s %6zu  %s\n", vectors[i].name, (int)f->id,
                f->type,
                f->flags & RELIGHT_FRAME_MORE ? "MORE"
                : f->flags                    ? "LAST"
                                              : "-",
                n, vectors[i].note);
    }
    return fclose(list) != 0;
}

int main(int argc, char **argv)
{
    n_vector = vectors_make(vectors);
    if (argc == 3 && !strcmp(argv[1], "--write")) return write_vectors(argv[2]);
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(encode_exact),
        cmocka_unit_test(decode_exact),
        cmocka_unit_test(decode_in_pieces),
        cmocka_unit_test(refused_payloads),
        cmocka_unit_test(refuses),
        cmocka_unit_test(whole_message_lengths),
        cmocka_unit_test(space_around_a_packed_frame),
        cmocka_unit_test(split_requests_are_refused),
        cmocka_unit_test(names),
        cmocka_unit_test(sha256),
        cmocka_unit_test(vector_hash),
    };
    return cmocka_run_group_tests_name("proto", tests, NULL, NULL);
}
