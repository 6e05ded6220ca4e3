/* SPDX-License-Identifier: MIT */
/* Embree 3 and 4 behind the same three calls. */
#ifndef PRT_TRACE_EMBREE_H
#define PRT_TRACE_EMBREE_H

#if __has_include(<embree4/rtcore.h>)
#include <embree4/rtcore.h>
static inline void embree_occluded16(const int *valid, RTCScene scene, struct RTCRay16 *ray)
{
    struct RTCOccludedArguments args;
    rtcInitOccludedArguments(&args);
    rtcOccluded16(valid, scene, ray, &args);
}
static inline void embree_intersect16(const int *valid, RTCScene scene, struct RTCRayHit16 *rh,
                                      int coherent)
{
    struct RTCIntersectArguments args;
    rtcInitIntersectArguments(&args);
    args.flags = coherent ? RTC_RAY_QUERY_FLAG_COHERENT : RTC_RAY_QUERY_FLAG_INCOHERENT;
    rtcIntersect16(valid, scene, rh, &args);
}
#else
#include <embree3/rtcore.h>
static inline void embree_occluded16(const int *valid, RTCScene scene, struct RTCRay16 *ray)
{
    struct RTCIntersectContext context;
    rtcInitIntersectContext(&context);
    rtcOccluded16(valid, scene, &context, ray);
}
static inline void embree_intersect16(const int *valid, RTCScene scene, struct RTCRayHit16 *rh,
                                      int coherent)
{
    struct RTCIntersectContext context;
    rtcInitIntersectContext(&context);
    context.flags =
        coherent ? RTC_INTERSECT_CONTEXT_FLAG_COHERENT : RTC_INTERSECT_CONTEXT_FLAG_INCOHERENT;
    rtcIntersect16(valid, scene, &context, rh);
}
#endif

#endif
