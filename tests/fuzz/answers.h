// SPDX-License-Identifier: MIT
// What a client may rely on: every byte the daemon sends belongs to a frame that parses,
// answers something that was asked, has the type of that, and nothing follows the last answer.
#ifndef TESTS_FUZZ_ANSWERS_H
#define TESTS_FUZZ_ANSWERS_H

#include "messages.h"

enum { ANSWERS_IDS = 4096 };

// One connection's view. Zero-initialise, then answers_init.
struct answers {
    struct relight_decoder decoder;
    bool exact; // every request was well-formed and is in `asked`
    bool greeted;
    uint16_t asked[ANSWERS_IDS]; // requests sent under an id
    uint16_t ended[ANSWERS_IDS]; // last answers that came under it
    uint16_t type[ANSWERS_IDS];  // of the request, 0xffff: of several types
    uint64_t more;               // id of a message whose payload goes on, 0: none
    uint16_t more_type;
};

void answers_init(struct answers *answers);
void answers_finish(struct answers *answers);
void answers_ask(struct answers *answers, uint64_t id, uint16_t type);
// NULL while all is well, else what was wrong. Ids of models and jobs go into the world.
const char *answers_take(struct answers *answers, struct world *world, const uint8_t *bytes,
                         size_t n);

#endif
