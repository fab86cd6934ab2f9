# Makes this package build where ROS 2 was installed from wheels instead of Debian packages.
#
# The message wheels were compiled inside a build container. The CMake targets they export still list the
# container's Python and numpy headers (/opt/python/cp312-cp312/...), and CMake refuses imported targets with
# include folders that do not exist. At the end of the configuration every such entry is replaced by the headers
# of the interpreter in use. Targets of an apt installation never match, so nothing happens there.

function(isf_use_own_python_headers)
  get_directory_property(targets DIRECTORY "${CMAKE_SOURCE_DIR}" IMPORTED_TARGETS)
  set(container_path "^/opt/python/cp[0-9]+-cp[0-9]+/")
  foreach(target IN LISTS targets)
    get_target_property(folders ${target} INTERFACE_INCLUDE_DIRECTORIES)
    if(NOT folders)
      continue()
    endif()
    set(kept ${folders})
    list(FILTER kept EXCLUDE REGEX "${container_path}")
    if(NOT kept STREQUAL folders)
      list(APPEND kept ${Python3_INCLUDE_DIRS} ${Python3_NumPy_INCLUDE_DIRS})
      set_target_properties(${target} PROPERTIES INTERFACE_INCLUDE_DIRECTORIES "${kept}")
    endif()
  endforeach()
endfunction()

find_package(Python3 REQUIRED COMPONENTS Interpreter Development.Module NumPy)
cmake_language(DEFER CALL isf_use_own_python_headers)
