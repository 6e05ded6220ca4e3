include(${CMAKE_CURRENT_LIST_DIR}/_target.cmake)
prt_fuzz(fuzz_config SOURCES fuzz/fuzz_config.c ROOMS relightd_rooms relight_proto SECONDS 3 LONG 600
  SEEDS ${CMAKE_CURRENT_LIST_DIR}/seeds/config)
