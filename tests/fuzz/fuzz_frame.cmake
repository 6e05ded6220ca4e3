include(${CMAKE_CURRENT_LIST_DIR}/_target.cmake)
prt_fuzz(fuzz_frame SOURCES fuzz/fuzz_frame.c ROOMS relight_proto SECONDS 3
  SEEDS ${CMAKE_SOURCE_DIR}/proto/vectors)
