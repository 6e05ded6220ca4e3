include(${CMAKE_CURRENT_LIST_DIR}/_target.cmake)
prt_fuzz(fuzz_tokens SOURCES fuzz/fuzz_tokens.c ROOMS relightd_rooms relight_proto SECONDS 3
  SEEDS ${CMAKE_CURRENT_LIST_DIR}/seeds/tokens)
