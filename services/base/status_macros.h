// Early return for absl::Status and absl::StatusOr.
#ifndef RIPS_SERVICES_BASE_STATUS_MACROS_H_
#define RIPS_SERVICES_BASE_STATUS_MACROS_H_

#include <utility>

#include "absl/status/status.h"
#include "absl/status/statusor.h"

#define RIPS_RETURN_IF_ERROR(expr)                                \
  do {                                                            \
    if (absl::Status _rips_status = (expr); !_rips_status.ok()) { \
      return _rips_status;                                        \
    }                                                             \
  } while (false)

#define RIPS_CONCAT_INNER_(a, b) a##b
#define RIPS_CONCAT_(a, b) RIPS_CONCAT_INNER_(a, b)

// RIPS_ASSIGN_OR_RETURN(auto x, F()): assigns F()'s value, or returns its status.
#define RIPS_ASSIGN_OR_RETURN(lhs, expr) \
  RIPS_ASSIGN_OR_RETURN_IMPL_(RIPS_CONCAT_(_rips_statusor_, __LINE__), lhs, expr)
#define RIPS_ASSIGN_OR_RETURN_IMPL_(statusor, lhs, expr)   \
  auto statusor = (expr);                                  \
  if (!statusor.ok()) return std::move(statusor).status(); \
  lhs = *std::move(statusor)

#endif  // RIPS_SERVICES_BASE_STATUS_MACROS_H_
