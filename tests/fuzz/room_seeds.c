// SPDX-License-Identifier: MIT
// room_seeds FOLDER: files of packed events for fuzz_room.
#include "../unit/room_actions.h"

int main(int argc, char **argv)
{
    if (argc != 2) return 2;
    for (unsigned file = 0; file < 20; file++) {
        char path[4096];
        struct rnd r;
        rnd_seed(&r, file);
        snprintf(path, sizeof path, "%s/%u", argv[1], file);
        FILE *out = fopen(path, "wb");
        if (!out) return 1;
        for (unsigned i = 0; i < 40; i++) {
            struct room_act a;
            struct room_evt e;
            uint8_t bytes[8192];
            act_random(&a, &r, i + 1);
            evt_make(&e, &a.action, rnd(&r, 4), 3, i + 2, i * UINT64_C(300000));
            size_t n = relight__room_event__pack(&e.event, bytes);
            fputc((int)(n & 255), out);
            fputc((int)(n >> 8), out);
            fwrite(bytes, 1, n, out);
        }
        if (fclose(out)) return 1;
    }
    return 0;
}
