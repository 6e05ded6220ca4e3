include(${CMAKE_CURRENT_LIST_DIR}/_target.cmake)
# No Draco among the seeds: libdraco itself crashes on damaged streams, which is what the child
# process is for, and this target runs without one.
prt_fuzz(fuzz_gltf SOURCES fuzz/fuzz_gltf.c LIBS prt_mesh SEEDS ${CMAKE_CURRENT_LIST_DIR}/seeds/model
  ${CMAKE_SOURCE_DIR}/../shared/data/models/features/BoxTextured_meshopt.glb
  ${CMAKE_SOURCE_DIR}/../shared/data/models/features/Box.gltf
  ${CMAKE_SOURCE_DIR}/../shared/data/broken/gltf)
