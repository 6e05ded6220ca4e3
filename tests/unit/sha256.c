// SPDX-License-Identifier: MIT
// SHA-256: the vectors of FIPS 180-4 and of NIST's CAVP, the instructions of the processor
// against plain C, and pieces of any size.
#include "sha256_c.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

static const struct code {
    const char *name;
    void (*init)(struct relight_sha256 *sha);
    void (*add)(struct relight_sha256 *sha, const void *bytes, size_t n);
    void (*hex)(struct relight_sha256 *sha, char out[65]);
} codes[] = {{"this processor", relight_sha256_init, relight_sha256_add, relight_sha256_hex},
             {"C", sha256_c_init, sha256_c_add, sha256_c_hex}};

static void hash(const struct code *code, const void *bytes, size_t n, char out[65])
{
    struct relight_sha256 sha;
    code->init(&sha);
    code->add(&sha, bytes, n);
    code->hex(&sha, out);
}

static void published_vectors(void **state)
{
    static const struct {
        const char *text, *hash;
    } vector[] = {
        {"", "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855"},
        {"abc", "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"},
        {"abcdbcdecdefdefgefghfghighijhijkijkljklmklmnlmnomnopnopq",
         "248d6a61d20638b8e5c026930c3e6039a33ce45964ff2167f6ecedd419db06c1"},
        {"abcdefghbcdefghicdefghijdefghijkefghijklfghijklmghijklmnhijklmnoijklmnopjklmnopqklmnopqr"
         "lmnopqrsmnopqrstnopqrstu",
         "cf5b16a778af8380036ce59e7b0492370b249b11e8f07a51afac45037afee9d1"}};
    enum { N_A = 1000000 };
    char got[65], *a = malloc(N_A);
    memset(a, 'a', N_A);
    for (int c = 0; c < 2; c++) {
        for (size_t i = 0; i < sizeof vector / sizeof *vector; i++) {
            hash(&codes[c], vector[i].text, strlen(vector[i].text), got);
            assert_string_equal(got, vector[i].hash);
        }
        hash(&codes[c], a, N_A, got);
        assert_string_equal(got,
                            "cdc76e5c9914fb9281a1c7e284d73e67f1809a48a497200e046d39ccc7112cd0");
    }
    free(a);
}

// Every length around four blocks, whole and in pieces, by both codes.
static void pieces_make_the_whole(void **state)
{
    uint8_t bytes[260];
    uint32_t seed = 1;
    for (size_t i = 0; i < sizeof bytes; i++)
        bytes[i] = (uint8_t)((seed = seed * 1664525 + 1013904223) >> 24);
    for (size_t n = 0; n <= sizeof bytes; n++) {
        char whole[65], got[65];
        hash(&codes[1], bytes, n, whole);
        for (int c = 0; c < 2; c++)
            for (size_t piece = 1; piece < 140; piece += piece < 4 ? 1 : 15) {
                struct relight_sha256 sha;
                codes[c].init(&sha);
                for (size_t at = 0; at < n; at += piece)
                    codes[c].add(&sha, bytes + at, n - at < piece ? n - at : piece);
                codes[c].hex(&sha, got);
                if (strcmp(got, whole))
                    fail_msg("%s: %zu bytes in pieces of %zu", codes[c].name, n, piece);
            }
    }
}

static void hashes_are_64_small_digits(void **state)
{
    char text[66];
    hash(&codes[0], "", 0, text);
    assert_true(relight_hash_valid(text));
    for (int i = 0; i < 64; i++) {
        const char was = text[i];
        for (const char *bad = "gG/:`A"; *bad; bad++) {
            text[i] = *bad;
            assert_false(relight_hash_valid(text));
        }
        text[i] = was;
    }
    text[64] = '0', text[65] = 0;
    assert_false(relight_hash_valid(text));
    text[63] = 0;
    assert_false(relight_hash_valid(text));
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(published_vectors),
                                       cmocka_unit_test(pieces_make_the_whole),
                                       cmocka_unit_test(hashes_are_64_small_digits)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
