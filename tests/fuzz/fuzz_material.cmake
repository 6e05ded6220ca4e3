include(${CMAKE_CURRENT_LIST_DIR}/_target.cmake)
prt_fuzz(fuzz_material SOURCES fuzz/fuzz_material.c ROOMS prt_medium prt_base LONG 600
  SEEDS ${CMAKE_CURRENT_LIST_DIR}/seeds/material
  ${CMAKE_SOURCE_DIR}/../shared/data/broken/gltf)
