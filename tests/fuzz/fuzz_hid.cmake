include(${CMAKE_CURRENT_LIST_DIR}/_target.cmake)
prt_fuzz(fuzz_hid SOURCES fuzz/fuzz_hid.c ROOMS relight_hid SECONDS 3
  SEEDS ${CMAKE_CURRENT_LIST_DIR}/seeds/hid)
