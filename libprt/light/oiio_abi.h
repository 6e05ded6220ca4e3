/* SPDX-License-Identifier: MIT */
/* C interface of libprt_oiio.so, which the decoding child opens with dlopen. */
#ifndef PRT_OIIO_ABI_H
#define PRT_OIIO_ABI_H

#include <stdint.h>
#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

struct prt_oiio_image {
    uint32_t width, height;
    float *rgb;  /* [height][width][3], malloc()ed */
    int is_srgb; /* integer pixels in [0,1], still to be linearised */
    char error[256];
};
/* Called with the declared size before any allocation; a non-zero result refuses the image. */
typedef int (*prt_oiio_size_fn)(void *user, uint64_t width, uint64_t height);
/* is_chroma: an EXR with Y RY BY or subsampled channels. 0 or -1 with image->error set. */
int prt_oiio_decode(const char *name, const void *bytes, size_t n, int is_chroma,
                    prt_oiio_size_fn allow, void *user, struct prt_oiio_image *image);
typedef int (*prt_oiio_decode_fn)(const char *, const void *, size_t, int, prt_oiio_size_fn,
                                  void *, struct prt_oiio_image *);

#ifdef __cplusplus
}
#endif
#endif
