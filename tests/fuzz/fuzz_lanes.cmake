include(${CMAKE_CURRENT_LIST_DIR}/_target.cmake)
prt_fuzz(fuzz_lanes SOURCES fuzz/fuzz_lanes.c ${CMAKE_SOURCE_DIR}/libprt/bake/lane_runs.c SECONDS 2
  SEEDS ${CMAKE_CURRENT_LIST_DIR}/seeds/lanes)
target_include_directories(fuzz_lanes PRIVATE ${CMAKE_SOURCE_DIR}/libprt)
if(NOT PRT_SANITIZE)
  target_compile_options(fuzz_lanes PRIVATE ${prt_instrument_flags} -fno-sanitize-recover=undefined)
  target_link_options(fuzz_lanes PRIVATE ${prt_instrument_flags})
endif()
