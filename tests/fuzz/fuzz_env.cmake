include(${CMAKE_CURRENT_LIST_DIR}/_target.cmake)
prt_fuzz(fuzz_env SOURCES fuzz/fuzz_env.c LIBS prt_light prt_base
  SEEDS ${CMAKE_CURRENT_LIST_DIR}/seeds/env ${CMAKE_SOURCE_DIR}/../shared/data/broken/hdr
  ${CMAKE_SOURCE_DIR}/../shared/data/broken/dds ${CMAKE_SOURCE_DIR}/../shared/data/broken/exr)
target_include_directories(fuzz_env PRIVATE ${CMAKE_SOURCE_DIR}/libprt)
