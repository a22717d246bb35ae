// A thin, typed skin over SQLite: a connection and prepared statements, errors as absl::Status.
// Internal to this folder. A connection and its statements are used by one thread at a time.
#ifndef RIPS_POLICY_SERVER_SERVER_STORE_SQLITE_DB_H_
#define RIPS_POLICY_SERVER_SERVER_STORE_SQLITE_DB_H_

#include <cstdint>
#include <memory>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"

struct sqlite3;
struct sqlite3_stmt;

namespace rips::store {

class Database;

// One execution of a statement; the statement is free again when this goes.
class [[nodiscard]] Query {
 public:
  explicit Query(sqlite3_stmt* statement) : statement_(statement) {}
  ~Query();
  Query(const Query&) = delete;
  Query& operator=(const Query&) = delete;

  // Parameters in order. Text may hold any bytes and is borrowed until this goes. A failed bind
  // shows in Step().
  Query& Bind(absl::string_view text);
  Query& Bind(int64_t number);
  // For a column of bytes.
  Query& BindBytes(absl::string_view bytes);
  Query& Bind(uint64_t number) { return Bind(static_cast<int64_t>(number)); }

  // True: a row is there to be read. False: done.
  absl::StatusOr<bool> Step();
  // Runs a statement that gives no row.
  absl::Status Run() { return Step().status(); }

  // Columns of the current row, from 0.
  std::string Text(int column) const;
  int64_t Number(int column) const;
  uint64_t Unsigned(int column) const { return static_cast<uint64_t>(Number(column)); }

 private:
  sqlite3_stmt* statement_;  // Not owned; outlives this.
  int bound_ = 0;
  int bind_code_ = 0;
};

class Statement {
 public:
  Statement() = default;
  // One Query at a time.
  Query Start() const { return Query(statement_.get()); }

 private:
  friend class Database;
  struct Finalize {
    void operator()(sqlite3_stmt* statement) const;
  };
  std::unique_ptr<sqlite3_stmt, Finalize> statement_;
};

class Database {
 public:
  enum class Mode { kReadWrite, kReadOnly };
  // The file must exist.
  static absl::StatusOr<Database> Open(const std::string& path, Mode mode);

  // Statements without parameters and rows, separated by semicolons.
  absl::Status Execute(const char* sql);
  absl::StatusOr<Statement> Prepare(absl::string_view sql);
  // First column of the first row, as text.
  absl::StatusOr<std::string> Ask(absl::string_view sql);

 private:
  struct Close {
    void operator()(sqlite3* connection) const;
  };
  explicit Database(std::unique_ptr<sqlite3, Close> connection)
      : connection_(std::move(connection)) {}

  std::unique_ptr<sqlite3, Close> connection_;
};

}  // namespace rips::store

#endif  // RIPS_POLICY_SERVER_SERVER_STORE_SQLITE_DB_H_
