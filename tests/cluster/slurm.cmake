add_test(NAME slurm COMMAND ${CMAKE_SOURCE_DIR}/deploy/cluster/with_slurm
  ${CMAKE_CURRENT_LIST_DIR}/slurm.sh ${CMAKE_BINARY_DIR}/bin)
set_tests_properties(slurm PROPERTIES LABELS cluster SKIP_RETURN_CODE 77)
# A time limit that was too short: Slurm ends a task after whole minutes.
add_test(NAME slurm_time COMMAND ${CMAKE_SOURCE_DIR}/deploy/cluster/with_slurm
  ${CMAKE_CURRENT_LIST_DIR}/slurm.sh ${CMAKE_BINARY_DIR}/bin time)
set_tests_properties(slurm_time PROPERTIES LABELS "cluster;long" SKIP_RETURN_CODE 77)
