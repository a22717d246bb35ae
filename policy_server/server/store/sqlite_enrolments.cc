#include "policy_server/server/store/sqlite_enrolments.h"

#include <fcntl.h>
#include <unistd.h>

#include <cerrno>
#include <utility>

#include "absl/strings/str_cat.h"
#include "services/base/status_macros.h"

namespace rips::store {
namespace {

// `RIPe`.
constexpr int kApplicationId = 0x52495065;
constexpr int kVersion = 1;

constexpr char kSchema[] = R"sql(
CREATE TABLE tokens (
  seq INTEGER PRIMARY KEY AUTOINCREMENT,
  id TEXT NOT NULL UNIQUE,
  robot TEXT NOT NULL,
  host TEXT NOT NULL,
  roles TEXT NOT NULL,
  by TEXT NOT NULL,
  time_unix_ns INTEGER NOT NULL,
  expires_unix_ns INTEGER NOT NULL,
  revoked INTEGER NOT NULL DEFAULT 0
) STRICT;
CREATE TABLE issued (
  seq INTEGER PRIMARY KEY AUTOINCREMENT,
  uri TEXT NOT NULL,
  serial TEXT NOT NULL,
  key_hash TEXT NOT NULL,
  token TEXT NOT NULL,                        -- empty = it was renewed
  time_unix_ns INTEGER NOT NULL,
  not_after_unix_ns INTEGER NOT NULL,
  certificates_pem TEXT NOT NULL
) STRICT;
CREATE INDEX issued_uri ON issued (uri, seq);
CREATE UNIQUE INDEX issued_token ON issued (token, uri) WHERE token != '';
)sql";

absl::Status MakeFile(const std::string& path) {
  const int fd = open(path.c_str(), O_RDWR | O_CREAT | O_CLOEXEC | O_NOFOLLOW, 0600);
  if (fd < 0) return absl::ErrnoToStatus(errno, absl::StrCat("opening `", path, "`"));
  close(fd);
  return absl::OkStatus();
}

TokenRecord ReadToken(const Query& query) {
  return {.id = query.Text(0),
          .robot = query.Text(1),
          .host = query.Text(2),
          .roles = query.Text(3),
          .by = query.Text(4),
          .time_unix_ns = query.Number(5),
          .expires_unix_ns = query.Number(6),
          .revoked = query.Number(7) != 0};
}

IssuedRecord ReadIssued(const Query& query) {
  return {.uri = query.Text(0),
          .serial = query.Text(1),
          .key_hash = query.Text(2),
          .token = query.Text(3),
          .time_unix_ns = query.Number(4),
          .not_after_unix_ns = query.Number(5),
          .certificates_pem = query.Text(6)};
}

}  // namespace

absl::StatusOr<std::unique_ptr<SqliteEnrolments>> SqliteEnrolments::Open(const std::string& path) {
  RIPS_RETURN_IF_ERROR(MakeFile(path));
  RIPS_ASSIGN_OR_RETURN(Database db, Database::Open(path, Database::Mode::kReadWrite));
  RIPS_ASSIGN_OR_RETURN(const std::string application, db.Ask("PRAGMA application_id"));
  RIPS_ASSIGN_OR_RETURN(const std::string version, db.Ask("PRAGMA user_version"));
  if (application == "0" && version == "0") {
    RIPS_RETURN_IF_ERROR(
        db.Execute(absl::StrCat("PRAGMA synchronous = FULL; BEGIN IMMEDIATE;", kSchema,
                                "PRAGMA application_id = ", kApplicationId,
                                "; PRAGMA user_version = ", kVersion, "; COMMIT;")
                       .c_str()));
  } else if (application != absl::StrCat(kApplicationId)) {
    return absl::DataLossError(absl::StrCat("`", path, "` is not a file of enrolments"));
  } else if (version != absl::StrCat(kVersion)) {
    return absl::FailedPreconditionError(
        absl::StrCat("`", path, "` has version ", version, ", this program writes ", kVersion,
                     "; use the program that wrote it, or a newer one"));
  }
  RIPS_RETURN_IF_ERROR(db.Execute("PRAGMA synchronous = FULL;"));
  std::unique_ptr<SqliteEnrolments> enrolments(new SqliteEnrolments(std::move(db)));
  RIPS_RETURN_IF_ERROR(enrolments->PrepareAll());
  return enrolments;
}

absl::Status SqliteEnrolments::PrepareAll() {
  MutexLock lock(&mu_);
  const struct {
    Statement* statement;
    std::string sql;
  } all[] = {
      {&put_token_,
       "INSERT INTO tokens (id, robot, host, roles, by, time_unix_ns, expires_unix_ns, revoked) "
       "VALUES (?, ?, ?, ?, ?, ?, ?, ?) ON CONFLICT (id) DO NOTHING RETURNING 1"},
      // By the time of the newest: what has expired by then goes first.
      {&prune_tokens_,
       absl::StrCat("DELETE FROM tokens WHERE seq IN (SELECT seq FROM tokens ORDER BY "
                    "(expires_unix_ns > ?1 AND revoked = 0) DESC, seq DESC LIMIT -1 OFFSET ",
                    kTokensMax, ")")},
      {&find_token_,
       "SELECT id, robot, host, roles, by, time_unix_ns, expires_unix_ns, revoked FROM tokens "
       "WHERE id = ?"},
      {&revoke_token_, "UPDATE tokens SET revoked = 1 WHERE id = ?"},
      {&list_tokens_,
       "SELECT id, robot, host, roles, by, time_unix_ns, expires_unix_ns, revoked FROM tokens "
       "ORDER BY seq DESC"},
      {&find_issued_,
       "SELECT uri, serial, key_hash, token, time_unix_ns, not_after_unix_ns, certificates_pem "
       "FROM issued WHERE token = ? AND uri = ?"},
      {&count_good_, "SELECT count(*) FROM issued WHERE uri = ? AND not_after_unix_ns > ?"},
      {&put_issued_,
       "INSERT INTO issued (uri, serial, key_hash, token, time_unix_ns, not_after_unix_ns,"
       " certificates_pem) VALUES (?, ?, ?, ?, ?, ?, ?)"},
      // What a token was used for must be known as long as the token is kept.
      {&prune_issued_,
       "DELETE FROM issued WHERE uri = ? AND not_after_unix_ns <= ? "
       "AND (token = '' OR token NOT IN (SELECT id FROM tokens))"},
      {&list_issued_,
       "SELECT uri, serial, key_hash, token, time_unix_ns, not_after_unix_ns, '' FROM issued "
       "WHERE ?1 = '' OR uri = ?1 ORDER BY seq DESC"},
  };
  for (const auto& [statement, sql] : all) {
    RIPS_ASSIGN_OR_RETURN(*statement, db_.Prepare(sql));
  }
  return absl::OkStatus();
}

absl::Status SqliteEnrolments::InTransaction(const std::function<absl::Status()>& work) {
  RIPS_RETURN_IF_ERROR(db_.Execute("BEGIN IMMEDIATE"));
  absl::Status status = work();
  if (status.ok()) status = db_.Execute("COMMIT");
  if (!status.ok()) db_.Execute("ROLLBACK").IgnoreError();  // there may be none any more
  return status;
}

absl::Status SqliteEnrolments::PutToken(const TokenRecord& token) {
  MutexLock lock(&mu_);
  return InTransaction([&]() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) -> absl::Status {
    Query put = put_token_.Start();
    put.Bind(token.id).Bind(token.robot).Bind(token.host).Bind(token.roles).Bind(token.by);
    put.Bind(token.time_unix_ns).Bind(token.expires_unix_ns).Bind(int64_t{token.revoked});
    RIPS_ASSIGN_OR_RETURN(const bool added, put.Step());
    if (!added) return absl::AlreadyExistsError("there is a token of that id");
    RIPS_RETURN_IF_ERROR(put.Run());  // a statement with RETURNING has to be run to its end
    return prune_tokens_.Start().Bind(token.time_unix_ns).Run();
  });
}

absl::StatusOr<TokenRecord> SqliteEnrolments::Find(absl::string_view id) {
  Query query = find_token_.Start();
  query.Bind(id);
  RIPS_ASSIGN_OR_RETURN(const bool row, query.Step());
  if (!row) return absl::NotFoundError(absl::StrCat("there is no token ", id));
  return ReadToken(query);
}

absl::StatusOr<TokenRecord> SqliteEnrolments::FindToken(absl::string_view id) {
  MutexLock lock(&mu_);
  return Find(id);
}

absl::Status SqliteEnrolments::RevokeToken(absl::string_view id) {
  MutexLock lock(&mu_);
  return InTransaction([&]() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) -> absl::Status {
    RIPS_RETURN_IF_ERROR(Find(id).status());
    return revoke_token_.Start().Bind(id).Run();
  });
}

absl::StatusOr<std::vector<TokenRecord>> SqliteEnrolments::ListTokens() {
  MutexLock lock(&mu_);
  std::vector<TokenRecord> tokens;
  Query query = list_tokens_.Start();
  while (true) {
    RIPS_ASSIGN_OR_RETURN(const bool row, query.Step());
    if (!row) return tokens;
    tokens.push_back(ReadToken(query));
  }
}

absl::Status SqliteEnrolments::CheckUnused(const IssuedRecord& issued) {
  Query find = find_issued_.Start();
  find.Bind(issued.token).Bind(issued.uri);
  RIPS_ASSIGN_OR_RETURN(const bool used, find.Step());
  if (!used) return absl::OkStatus();
  if (find.Text(2) == issued.key_hash) {
    return absl::AlreadyExistsError("the token gave this key its certificate before");
  }
  return absl::FailedPreconditionError(
      absl::StrCat("the token was used already, by another key, for ", issued.uri,
                   "; if that was not this robot, ban that certificate; make a new token"));
}

absl::Status SqliteEnrolments::PutIssued(const IssuedRecord& issued) {
  MutexLock lock(&mu_);
  return InTransaction([&]() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) -> absl::Status {
    if (!issued.token.empty()) {
      RIPS_ASSIGN_OR_RETURN(const TokenRecord token, Find(issued.token));
      if (token.revoked) return absl::FailedPreconditionError("the token is revoked");
      RIPS_RETURN_IF_ERROR(CheckUnused(issued));
    }
    RIPS_RETURN_IF_ERROR(prune_issued_.Start().Bind(issued.uri).Bind(issued.time_unix_ns).Run());
    {
      Query count = count_good_.Start();
      count.Bind(issued.uri).Bind(issued.time_unix_ns);
      RIPS_RETURN_IF_ERROR(count.Step().status());
      if (count.Number(0) >= kGoodPerIdentityMax) {
        return TooManyGood(issued.uri, count.Number(0));
      }
    }
    return put_issued_.Start()
        .Bind(issued.uri)
        .Bind(issued.serial)
        .Bind(issued.key_hash)
        .Bind(issued.token)
        .Bind(issued.time_unix_ns)
        .Bind(issued.not_after_unix_ns)
        .Bind(issued.certificates_pem)
        .Run();
  });
}

absl::StatusOr<IssuedRecord> SqliteEnrolments::FindIssued(absl::string_view token,
                                                          absl::string_view uri) {
  MutexLock lock(&mu_);
  Query query = find_issued_.Start();
  query.Bind(token).Bind(uri);
  RIPS_ASSIGN_OR_RETURN(const bool row, query.Step());
  if (!row) return absl::NotFoundError("the token gave it no certificate");
  return ReadIssued(query);
}

absl::StatusOr<std::vector<IssuedRecord>> SqliteEnrolments::ListIssued(absl::string_view uri) {
  MutexLock lock(&mu_);
  std::vector<IssuedRecord> all;
  Query query = list_issued_.Start();
  query.Bind(uri);
  while (true) {
    RIPS_ASSIGN_OR_RETURN(const bool row, query.Step());
    if (!row) return all;
    all.push_back(ReadIssued(query));
  }
}

}  // namespace rips::store
