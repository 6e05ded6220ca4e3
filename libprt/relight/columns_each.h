// SPDX-License-Identifier: MIT
// A kernel of columns (kernels.h) over the file's own add_units(), which is compiled for each
// number of lights. Included in a region of base/isa.h; COLUMNS_NAME names the kernel.
#define CASE(n_light)                                                  \
    case n_light:                                                      \
        entry = add_units(part, k, stop, entry, n_light, stride, sum); \
        break;

void COLUMNS_NAME(const struct column_part *part, size_t n, size_t stride, float *sum)
{
    for (const struct column_part *end = part + n; part < end; part++) {
        const int16_t *entry = part->entry;
        uint32_t k = 0;
        // fewer and fewer lights
        for (unsigned l = part->n_light; l; l--) {
            const uint32_t stop = part->n[l - 1];
            switch (l) {
                CASE(1) CASE(2) CASE(3) CASE(4) CASE(5) CASE(6) CASE(7) CASE(8)
            }
            k = stop;
        }
    }
}
_Static_assert(LIGHT_GROUP == 8, "a case for each number of lights");
#undef CASE
