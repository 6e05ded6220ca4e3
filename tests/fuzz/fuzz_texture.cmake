include(${CMAKE_CURRENT_LIST_DIR}/_target.cmake)
prt_fuzz(fuzz_texture SOURCES fuzz/fuzz_texture.c LIBS prt_texture
  SEEDS ${CMAKE_CURRENT_LIST_DIR}/seeds/texture)
