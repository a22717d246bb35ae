#include "services/runtime/config_sections.h"

#include <sys/stat.h>
#include <unistd.h>

#include <cstdlib>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "services/base/status_matchers.h"
#include "services/runtime/atomic_file.h"
#include "services/runtime/daemon_flags.h"
#include "services/runtime/log.h"

namespace rips {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;

class TempDir {
 public:
  TempDir() {
    char name[] = "/tmp/rips-test-XXXXXX";
    path_ = mkdtemp(name);
  }
  ~TempDir() { EXPECT_EQ(std::system(("rm -rf " + path_).c_str()), 0); }
  std::string operator/(const std::string& name) const { return path_ + "/" + name; }

 private:
  std::string path_;
};

TEST(ConfigSectionsTest, ReadsTlsAndDds) {
  ConfigReader reader("f.yaml",
                      "tls: {ca: /a, cert: /b, key: /c}\n"
                      "dds: {domain: 7, interface: lo, security: {keystore: /k, enclave: /e}}\n");
  EXPECT_EQ(ReadTls(reader.root()), (TlsFiles{"/a", "/b", "/c"}));
  EXPECT_EQ(ReadDds(reader.root()), (DdsSettings{7, "lo", "/k", "/e"}));
  EXPECT_THAT(reader.Finish(), IsOk());
}

TEST(ConfigSectionsTest, ReadsHowTheProcessIsAnnounced) {
  const auto read = [](const std::string& text) {
    ConfigReader reader("f.yaml", text);
    const DdsSettings settings = ReadDds(reader.root());
    EXPECT_THAT(reader.Finish(), IsOk()) << text;
    return settings;
  };
  EXPECT_TRUE(read("dds: {}").announce);
  EXPECT_EQ(read("dds: {}").gid_bytes, 0u);
  EXPECT_FALSE(read("dds: {announce: false}").announce);
  EXPECT_EQ(read("dds: {gid_bytes: 16}").gid_bytes, 16u);
  EXPECT_EQ(read("dds: {gid_bytes: 24}").gid_bytes, 24u);
  EXPECT_EQ(read("dds: {gid_bytes: auto}").gid_bytes, 0u);
}

TEST(ConfigSectionsTest, NamesWhatIsWrong) {
  struct Case {
    const char* text;
    const char* message;
  };
  const Case cases[] = {
      {"dds: {}", "missing key `tls`"},
      {"tls: {ca: /a, cert: b, key: /c}", "`cert` is `b`; write an absolute path"},
      {"tls: {ca: /a, key: /c}", "missing key `tls.cert`"},
      {"tls: {ca: /a, cert: /b, key: /c}\ndds: {domain: 231}",
       "`domain` is 231; it must be from 0 to 230"},
      {"tls: {ca: /a, cert: /b, key: /c}\ndds: {security: {keystore: /k}}",
       "missing key `dds.security.enclave`"},
      {"tls: {ca: /a, cert: /b, key: /c}\ndds: {security: {keystore: /k, enclave: e}}",
       "`enclave` must begin with `/`"},
      {"tls: {ca: /a, cert: /b, key: /c}\ndds: {gid_bytes: 20}",
       "`gid_bytes` is `20`; write `auto` or `16` or `24`"},
  };
  for (const Case& c : cases) {
    ConfigReader reader("f.yaml", c.text);
    ReadTls(reader.root());
    ReadDds(reader.root());
    EXPECT_THAT(reader.Finish(), StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr(c.message)))
        << c.text;
  }
}

TEST(ConfigSectionsTest, ReadsNames) {
  ConfigReader reader("f.yaml", "robot: r1\nhost: Base\n");
  std::string robot;
  std::string host;
  ReadName(reader.root(), "robot", "robot id", &robot);
  ReadName(reader.root(), "host", "host id", &host);

  EXPECT_EQ(robot, "r1");
  EXPECT_THAT(reader.Finish(), StatusIs(absl::StatusCode::kInvalidArgument,
                                        HasSubstr("f.yaml:2:7: `Base` is not a valid host id")));
}

TEST(ConfigSectionsTest, KnowsHostAndPort) {
  for (const char* good : {"a:1", "policy.example:7443", "127.0.0.1:0", "[::1]:65535"}) {
    EXPECT_TRUE(IsHostPort(good)) << good;
  }
  for (const char* bad : {"", "a", ":1", "a:", "a:65536", "a:-1", "a:x", "::1:5", "[]:1", "[::1:5",
                          "a b:1", "unix:/x:1", "a:1 ", "a:000001"}) {
    EXPECT_FALSE(IsHostPort(bad)) << bad;
  }
}

// A user who may write to the directory could stop the thread that writes a state file.
TEST(AtomicFileTest, AFifoInThePlaceOfItsTemporaryFileStopsNothing) {
  const TempDir dir;
  const std::string path = dir / "state";
  ASSERT_EQ(mkfifo((path + ".tmp").c_str(), 0600), 0);

  EXPECT_THAT(WriteFileAtomically(path, "text"), Not(IsOk()));
  EXPECT_THAT(WriteFileAtomically(path, "text"), IsOk());
  EXPECT_EQ(*ReadFile(path, 10), "text");
}

TEST(AtomicFileTest, ReplacesTheWholeFile) {
  const TempDir dir;
  const std::string path = dir / "state";
  const std::string bytes("a\0b\n", 4);

  ASSERT_THAT(WriteFileAtomically(path, "longer than the next"), IsOk());
  ASSERT_THAT(WriteFileAtomically(path, bytes), IsOk());

  EXPECT_EQ(*ReadFile(path, 4), bytes);
  struct stat info {};
  ASSERT_EQ(stat(path.c_str(), &info), 0);
  EXPECT_EQ(info.st_mode & 0777, 0600u);
  EXPECT_NE(access((path + ".tmp").c_str(), F_OK), 0);
}

TEST(AtomicFileTest, KeepsTheOldFileWhenItCannotWrite) {
  const TempDir dir;
  const std::string path = dir / "state";
  ASSERT_THAT(WriteFileAtomically(path, "old"), IsOk());
  ASSERT_EQ(mkdir((path + ".tmp").c_str(), 0700), 0);

  EXPECT_THAT(WriteFileAtomically(path, "new"),
              StatusIs(absl::StatusCode::kUnavailable, HasSubstr("cannot create")));

  EXPECT_EQ(*ReadFile(path, 100), "old");
  EXPECT_THAT(WriteFileAtomically(dir / "no/such", "x"), StatusIs(absl::StatusCode::kNotFound));
}

TEST(AtomicFileTest, BoundsWhatItReads) {
  const TempDir dir;
  ASSERT_THAT(WriteFileAtomically(dir / "f", "12345"), IsOk());
  ASSERT_EQ(mkfifo((dir / "fifo").c_str(), 0600), 0);

  EXPECT_EQ(*ReadFile(dir / "f", 5), "12345");
  EXPECT_THAT(ReadFile(dir / "f", 4),
              StatusIs(absl::StatusCode::kResourceExhausted, HasSubstr("limit of 4 bytes")));
  EXPECT_THAT(ReadFile(dir / "none", 4), StatusIs(absl::StatusCode::kNotFound));
  EXPECT_THAT(ReadFile(dir / "fifo", 4), StatusIs(absl::StatusCode::kFailedPrecondition));
  EXPECT_THAT(ReadFile(dir / ".", 4), StatusIs(absl::StatusCode::kFailedPrecondition));
  EXPECT_THAT(ReadConfigFile("/dev/zero"), StatusIs(absl::StatusCode::kFailedPrecondition));
}

const DaemonInfo kInfo = {"rips-x", "Does x.", "/etc/rips/x.yaml"};

TEST(DaemonFlagsTest, HasDefaults) {
  const char* argv[] = {"rips-x"};
  DaemonFlags flags;

  EXPECT_EQ(ParseDaemonFlags(1, argv, kInfo, &flags), std::nullopt);

  EXPECT_EQ(flags.config, "/etc/rips/x.yaml");
  EXPECT_FALSE(flags.check_config);
  EXPECT_THAT(WriteReadyFile(flags, "ready"), IsOk());
}

TEST(DaemonFlagsTest, ReadsFlagsAndWritesTheReadyFile) {
  const TempDir dir;
  const std::string ready = dir / "ready";
  const char* argv[] = {"rips-x",      "--config", "c.yaml",       "--check-config",
                        "--log-level", "warning",  "--ready-file", ready.c_str()};
  DaemonFlags flags;

  EXPECT_EQ(ParseDaemonFlags(8, argv, kInfo, &flags), std::nullopt);
  EXPECT_FALSE(LogEnabled(LogLevel::kInfo));
  SetLogLevel(LogLevel::kInfo);

  EXPECT_EQ(flags.config, "c.yaml");
  EXPECT_TRUE(flags.check_config);
  ASSERT_THAT(WriteReadyFile(flags, "127.0.0.1:7443"), IsOk());
  EXPECT_EQ(*ReadFile(ready, 100), "127.0.0.1:7443\n");
}

TEST(DaemonFlagsTest, EndsForVersionHelpAndMistakes) {
  DaemonFlags flags;
  const auto run = [&](const char* flag, const char* value) {
    const char* argv[] = {"rips-x", flag, value};
    return ParseDaemonFlags(value == nullptr ? 2 : 3, argv, kInfo, &flags);
  };

  ::testing::internal::CaptureStdout();
  EXPECT_EQ(run("--version", nullptr), 0);
  EXPECT_THAT(::testing::internal::GetCapturedStdout(), HasSubstr("rips-x 0.1.0"));
  EXPECT_EQ(run("--help", nullptr), 0);
  EXPECT_EQ(run("--cofnig", "x"), kExitConfig);
  EXPECT_EQ(run("--config", nullptr), kExitConfig);
  EXPECT_EQ(run("--log-level", "loud"), kExitConfig);
}

}  // namespace
}  // namespace rips
